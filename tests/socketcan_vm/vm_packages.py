"""Find or fetch what the virtual machine is made of: host tools (installed), kernel and busybox (only unpacked)."""

import os
import re
import shutil
import subprocess
from pathlib import Path

TOOLS = {  # program: Debian package
    "qemu-system-x86_64": "qemu-system-x86",
    "depmod": "kmod",
    "mksquashfs": "squashfs-tools",
    "cpio": "cpio",
}
SBIN = "/usr/sbin:/sbin"  # depmod lives there, which is not on every user's PATH


class NotInstallableError(Exception):
    """This machine cannot get qemu, the tools or the kernel. Example: no apt-get, no network, not root."""


def which(program: str) -> str | None:
    """Path of `program`, looked up on PATH and in the system folders."""
    return shutil.which(program, path=os.environ.get("PATH", os.defpath) + ":" + SBIN)


def _apt(arguments: list[str], folder: Path | None = None) -> subprocess.CompletedProcess[str]:
    options = ["-o", "APT::Sandbox::User=root"] if os.geteuid() == 0 else []
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"}
    return subprocess.run(
        [arguments[0], *options, *arguments[1:]],
        cwd=folder,
        env=environment,
        text=True,
        capture_output=True,
        check=False,
    )


def _apt_get(arguments: list[str], folder: Path | None = None) -> None:
    """Run apt-get; when it fails, once more after an update of the package lists (a fresh machine has none)."""
    outcome = _apt(["apt-get", *arguments], folder)
    if outcome.returncode != 0:
        if os.geteuid() == 0:
            _apt(["apt-get", "update"])
            outcome = _apt(["apt-get", *arguments], folder)
        if outcome.returncode != 0:
            last = (outcome.stderr.strip() or outcome.stdout.strip() or "no message").splitlines()[-1]
            raise NotInstallableError(f"`apt-get {' '.join(arguments)}` failed: {last}")


def install_tools() -> None:
    """Install the host tools that are missing; raises NotInstallableError with the command that would do it."""
    missing = [package for program, package in TOOLS.items() if which(program) is None]
    if not missing:
        return
    if which("apt-get") is None:
        raise NotInstallableError(f"missing {', '.join(missing)}, and there is no apt-get (needs Debian's packages)")
    command = ["install", "-y", "--no-install-recommends", *missing]
    if os.geteuid() != 0:
        raise NotInstallableError(f"missing {', '.join(missing)}: run `sudo apt-get {' '.join(command)}`")
    print(f"installing {', '.join(missing)}", flush=True)
    _apt_get(command)
    still = [program for program in TOOLS if which(program) is None]
    if still:
        raise NotInstallableError(f"installed {', '.join(missing)}, but found no {', '.join(still)}")


def newest_kernel_package() -> str | None:
    """Name of the newest stock kernel package that apt knows, None where it knows none."""
    names = re.findall(
        r"Depends: (linux-image-\d[\w.+-]*-amd64)", _apt(["apt-cache", "depends", "linux-image-amd64"]).stdout
    )
    return max(names, key=version_key, default=None)


def version_key(name: str) -> list[int]:
    """The numbers of a package name, to sort by: linux-image-6.1.0-9-amd64 comes before linux-image-6.1.0-56-amd64."""
    return [int(number) for number in re.findall(r"\d+", name)]


def unpack(package: str, folder: Path) -> Path:
    """Folder `folder/package` with the unpacked Debian package; downloads it if it is not there."""
    target = folder / package
    if target.exists():
        return target
    partial = folder / f"{package}.{os.getpid()}.partial"
    (partial / "root").mkdir(parents=True)
    try:
        print(f"downloading {package}", flush=True)
        _apt_get(["download", package], partial)
        for archive in partial.glob("*.deb"):
            subprocess.run(["dpkg", "-x", str(archive), str(partial / "root")], check=True)
        (partial / "root").rename(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return target


def unpack_kernel(folder: Path) -> tuple[Path, str]:
    """(unpacked package, release such as "6.1.0-56-amd64") of the newest kernel, module dependencies computed.

    Without network the newest one of an earlier run serves.
    """
    package = newest_kernel_package()
    if package is None and os.geteuid() == 0:
        _apt(["apt-get", "update"])
        package = newest_kernel_package()
    if package is None:
        earlier = [path.name for path in folder.glob("linux-image-*-amd64")]
        if not earlier:
            raise NotInstallableError(
                "apt knows no package linux-image-amd64 (needs Debian on x86-64 and its package lists)"
            )
        package = max(earlier, key=version_key)
    root = unpack(package, folder)
    release = package.removeprefix("linux-image-")
    modules = root / "lib" / "modules" / release
    if not modules.exists():  # newer Debian has /lib merged into /usr
        modules = root / "usr" / "lib" / "modules" / release
        (root / "lib").symlink_to("usr/lib")
    if not (modules / "modules.dep").exists():
        depmod = which("depmod")
        assert depmod is not None
        subprocess.run([depmod, "-b", str(root), release], check=True)
    return root, release

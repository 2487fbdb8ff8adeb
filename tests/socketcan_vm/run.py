"""Run a command on a kernel with real SocketCAN: a small virtual machine that shares this machine's files, read-only.

    .venv/bin/python tests/socketcan_vm/run.py [--keep-images] [--drivers] [--time-limit SECONDS] [COMMAND...]

Without COMMAND it runs guest_tests.py, with --drivers without its bench. The exit code is the command's; 77 where qemu
or the kernel cannot be had here, 124 when the time limit ended the guest, 125 when the guest ended without a result.
See README.md beside this file.
"""

import argparse
import hashlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from vm_images import build_initramfs, build_python_images, uncompressed_kernel
from vm_packages import NotInstallableError, install_tools, unpack, unpack_kernel, which

HERE: Final = Path(__file__).resolve().parent
CHECKOUT: Final = HERE.parents[1]
CANNOT_RUN_HERE: Final = 77
TIMED_OUT: Final = 124
NO_RESULT: Final = 125
ABANDONED_S: Final = 3600.0
GUEST_OUTPUT: Final = "/run/socketcan_vm"  # in the guest: a folder of the host, the one place it can write to


def cache_folder() -> Path:
    """.cache/socketcan_vm in the checkout, or under $XDG_CACHE_HOME where that is set."""
    base = os.environ.get("XDG_CACHE_HOME")
    folder = Path(base) / "servohil" / "socketcan_vm" if base else CHECKOUT / ".cache" / "socketcan_vm"
    folder.mkdir(parents=True, exist_ok=True)
    return folder.resolve()


def shared_environment(caches: Path) -> dict[str, str]:
    """What host and guest must agree on to share what is under `caches`."""
    return {
        # numba names the processor in its cache: without these the guest would compile everything anew
        "NUMBA_CPU_NAME": "x86-64-v2",
        "NUMBA_CPU_FEATURES": "",
        "NUMBA_CACHE_DIR": str(caches / "numba"),
        "MPLCONFIGDIR": str(caches / "matplotlib"),  # its list of fonts takes the guest a minute to make
    }


def warm_up(caches: Path, options: list[str]) -> None:
    """Compile on the host what the guest will run. A failure is only told: the guest's own result counts."""
    key = hashlib.sha256(repr(options).encode())
    for room in ("estimators", "control", "drivers", "hil", "sim_bench", "rigs", "tests/drivers", "tests/socketcan_vm"):
        for path in sorted((CHECKOUT / room).rglob("*.*")):
            if path.suffix in {".py", ".toml", ".dbc"}:  # numba's index looks at the time of a source as well
                key.update(f"{path}:{path.stat().st_mtime_ns}\n".encode())
    stamp = caches / "warmed-up"
    if stamp.exists() and stamp.read_text() == key.hexdigest():
        return
    shutil.rmtree(caches, ignore_errors=True)
    caches.mkdir()
    print("compiling on the host", flush=True)
    command = [sys.executable, str(HERE / "guest_tests.py"), "--warm-up", *options]
    outcome = subprocess.run(command, cwd=CHECKOUT, env={**os.environ, **shared_environment(caches)}, check=False)
    if outcome.returncode == 0:
        stamp.write_text(key.hexdigest())
    else:
        print(f"the warm-up failed (exit code {outcome.returncode}): the guest compiles for itself, slowly", flush=True)


def write_job(job: Path, command: list[str], mounts: Iterable[tuple[str, Path]], caches: Path, limit_s: int) -> None:
    """What `init` reads in the guest: the command as a script, the images' places, the time limit, and copies of the
    checkout and of the caches (times in ns kept: numba's index compares them, and squashfs rounds them)."""
    environment = {
        "PATH": f"{Path(sys.executable).parent}:/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "HOME": os.environ.get("HOME", "/root"),
        "LANG": "C.UTF-8",
        "TERM": "dumb",
        "PYTHONUNBUFFERED": "1",
        "SERVOHIL_GUEST_OUTPUT": GUEST_OUTPUT,
        **shared_environment(caches),
    }
    lines = ["#!/bin/sh", f"cd {shlex.quote(str(CHECKOUT))} || exit 125"]
    lines += [f"export {name}={shlex.quote(value)}" for name, value in environment.items()]
    lines += [f"exec {shlex.join(command)}"]
    script = job / "command"
    script.write_text("\n".join(lines) + "\n")
    script.chmod(0o755)
    (job / "mounts").write_text("".join(f"{device} {path}\n" for device, path in mounts))
    (job / "checkout_path").write_text(f"{CHECKOUT}\n")
    (job / "caches_path").write_text(f"{caches}\n")
    (job / "output").mkdir()
    shutil.copytree(CHECKOUT, job / "checkout", symlinks=True, ignore=_not_sources)
    shutil.copytree(caches, job / "caches")
    (job / "time_limit_s").write_text(f"{limit_s}\n")


def _not_sources(folder: str, names: list[str]) -> set[str]:
    """Of the checkout's own entries, what a guest has no use for: environment, caches, history, recordings."""
    if Path(folder) != CHECKOUT:
        return set()
    return {name for name in names if (name.startswith(".") and name != ".ci") or name in {"runs", "build", "dist"}}


def qemu_command(kernel: Path, initramfs: Path, images: list[Path], job: Path) -> list[str]:
    """Software emulation on purpose: a stock kernel may hang under a nested /dev/kvm.

    The guest's clock counts instructions, 1 ns each (-icount): to its programs this is a processor of constant speed, a
    few times slower than ours, however busy the host is. A real-time loop in the guest keeps its deadlines; the minutes
    that the emulation takes pass outside. While all of the guest sleeps, its clock is the host's. (erms, fsrm: an
    emulated `rep movsb` goes byte by byte, so let nobody prefer it.)
    """
    qemu = which("qemu-system-x86_64")
    assert qemu is not None
    command = [
        qemu, "-accel", "tcg,thread=single", "-icount", "shift=0", "-machine", "q35", "-cpu", "max,erms=off,fsrm=off",
        "-m", "3072", "-nic", "none", "-no-reboot", "-nodefaults", "-no-user-config", "-display", "none",
        "-rtc", "base=utc", "-serial", "stdio", "-kernel", str(kernel), "-initrd", str(initramfs),
        "-append", "console=ttyS0 loglevel=0 panic=-1 mitigations=off init_on_alloc=0 apparmor=0 audit=0",
    ]  # fmt: skip
    command += ["-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"]
    command += ["-virtfs", f"local,path={_quoted(job)},mount_tag=job,security_model=none"]
    for image in images:
        command += ["-drive", f"file={_quoted(image)},format=raw,if=virtio,readonly=on"]
    return command


def _quoted(path: Path) -> str:
    return str(path).replace(",", ",,")  # a comma ends a value in qemu's options


def exit_code_of(last_line: str) -> int:
    """The guest's `exit code N`, its last line; NO_RESULT for anything else."""
    found = re.fullmatch(r"exit code (\d+)", last_line.strip())
    if found is None:
        return NO_RESULT
    # a command that happens to end with "cannot run here" has run and has failed
    return 1 if int(found[1]) == CANNOT_RUN_HERE else int(found[1])


def run_guest(command: list[str], limit_s: int) -> int:
    """Boot, copy the guest's console to stdout, end qemu at the time limit. Returns the guest's exit code."""
    guest = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True, errors="replace")
    assert guest.stdout is not None
    timed_out = threading.Event()

    def end() -> None:
        timed_out.set()
        guest.kill()

    timer = threading.Timer(limit_s, end)
    timer.daemon = True
    timer.start()
    last_line = ""
    try:
        for line in guest.stdout:
            print(line, end="", flush=True)
            last_line = line.strip() or last_line
        guest.wait()
    finally:
        timer.cancel()
        guest.kill()
        guest.wait()
    if timed_out.is_set():
        print(f"time limit of {limit_s} s reached: the guest was stopped", flush=True)
        return TIMED_OUT
    code = exit_code_of(last_line)
    if code == NO_RESULT:
        print(f"the guest ended without a result (qemu's exit code {guest.returncode})", flush=True)
    return code


def main() -> int:
    """Prepare what is missing, run the command in the guest, return its exit code."""
    parser = argparse.ArgumentParser(description="Run COMMAND on a kernel with vcan0 (default: guest_tests.py).")
    parser.add_argument(
        "--keep-images", action="store_true", help="use the Python images as they are, even if outdated"
    )
    parser.add_argument("--drivers", action="store_true", help="of guest_tests.py everything but the bench")
    parser.add_argument("--time-limit", type=int, default=900, metavar="S", help="stop the guest after S seconds (900)")
    parser.add_argument("command", nargs=argparse.REMAINDER, metavar="COMMAND")
    arguments = parser.parse_args()
    if sys.prefix == sys.base_prefix:
        parser.error(f"run it with the project's environment: {CHECKOUT}/.venv/bin/python {sys.argv[0]}")
    options = ["--drivers"] if arguments.drivers else []
    command = arguments.command or [sys.executable, str(HERE / "guest_tests.py"), *options]
    start = time.monotonic()
    folder = cache_folder()
    for left in folder.glob("guest-*"):  # by a run that was killed
        if time.time() - left.stat().st_mtime > ABANDONED_S:
            shutil.rmtree(left, ignore_errors=True)
    try:
        install_tools()
        kernel, release = unpack_kernel(folder)
        busybox = unpack("busybox-static", folder)
    except NotInstallableError as reason:
        print(f"socketcan_vm: cannot run here: {reason}", flush=True)
        return CANNOT_RUN_HERE
    image = uncompressed_kernel(kernel / "boot" / f"vmlinuz-{release}", folder)
    initramfs = build_initramfs(kernel, release, busybox, HERE / "init", folder)
    images = build_python_images(folder, CHECKOUT / "requirements.lock", keep=arguments.keep_images)
    caches = folder / "caches"
    warm_up(caches, options)
    print(f"prepared in {time.monotonic() - start:.1f} s, booting {release}", flush=True)
    with tempfile.TemporaryDirectory(prefix="guest-", dir=folder) as job:
        mounts = [(f"vd{letter}", path) for letter, (_, path) in zip("abcdef", images, strict=False)]
        write_job(Path(job), command, mounts, caches, arguments.time_limit)
        qemu = qemu_command(image, initramfs, [path for path, _ in images], Path(job))
        code = run_guest(qemu, arguments.time_limit)
        last_output = folder / "last-output"
        shutil.rmtree(last_output, ignore_errors=True)
        shutil.copytree(Path(job) / "output", last_output)
    print(f"socketcan_vm: {time.monotonic() - start:.0f} s in all, what the guest wrote: {last_output}", flush=True)
    return code


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # unwinds, which ends qemu
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)

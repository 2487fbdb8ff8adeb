"""The guest's images, built once and kept until what they are made from changes: initramfs, and Python as squashfs.

Imports from a squashfs on a virtio disk are three times as fast as over 9p, and most of a run is imports.
"""

import hashlib
import lzma
import os
import shutil
import struct
import subprocess
import sys
import sysconfig
from pathlib import Path

MODULES = (
    "virtio_pci", "9pnet_virtio", "9p", "overlay", "virtio_blk", "squashfs", "can", "can_raw", "can_bcm", "vcan",
)  # fmt: skip

XZ_MAGIC = b"\xfd7zXZ\0"


def load_order(modules_dep: str, builtin: str, wanted: tuple[str, ...]) -> list[str]:
    """Files of the `wanted` modules and of all they need, each after what it needs.

    modules_dep, builtin: contents of modules.dep and modules.builtin. Raises KeyError for a module in neither.
    """
    needs: dict[str, list[str]] = {}
    for line in modules_dep.splitlines():
        file, _, rest = line.partition(":")
        needs[file] = rest.split()
    by_name = {_module_name(file): file for file in needs}
    inside = {_module_name(file) for file in builtin.split()}
    order: list[str] = []

    def visit(file: str) -> None:
        if file not in order:
            for needed in needs[file]:
                visit(needed)
            order.append(file)

    for name in wanted:
        if name not in inside:
            visit(by_name[name])
    return order


def _module_name(file: str) -> str:
    return Path(file).name.split(".ko")[0].replace("-", "_")


def uncompressed_kernel(image: Path, target: Path) -> Path:
    """The ELF file inside a kernel image, which qemu boots as it is (PVH): unpacking would cost the guest 10 s.

    The place is in the image's header (Documentation/arch/x86/boot.rst: setup_sects, payload_offset, payload_length).
    An image that is not packed with xz is returned unchanged.
    """
    data = image.read_bytes()
    offset, length = struct.unpack_from("<II", data, 0x248)
    payload = data[((data[0x1F1] or 4) + 1) * 512 + offset :][:length]
    if not payload.startswith(XZ_MAGIC):
        return image
    kernel = target / f"vmlinux-{image.name.removeprefix('vmlinuz-')}"
    if not kernel.exists():
        _replace(kernel, lzma.LZMADecompressor().decompress(payload))
        _forget_others("vmlinux-*", kernel)
    return kernel


def build_initramfs(kernel: Path, release: str, busybox: Path, init: Path, target: Path) -> Path:
    """Static busybox, the modules in load order and `init` as a cpio archive in `target`, unless it is there."""
    key = _key(release, ",".join(MODULES), init.read_text(), busybox.name)
    image = target / f"initramfs-{key}.cpio"
    if image.exists():
        return image
    modules = kernel / "lib" / "modules" / release
    tree = target / f"initramfs.{os.getpid()}.partial"
    (tree / "bin").mkdir(parents=True)
    (tree / "modules").mkdir()
    try:
        shutil.copy(busybox / "bin" / "busybox", tree / "bin" / "busybox")
        shutil.copy(init, tree / "init")
        (tree / "init").chmod(0o755)
        order = load_order((modules / "modules.dep").read_text(), (modules / "modules.builtin").read_text(), MODULES)
        for file in order:
            data = (modules / file).read_bytes()
            name = Path(file).name
            if name.endswith(".xz"):  # newer Debian; busybox may not know how
                data, name = lzma.decompress(data), name.removesuffix(".xz")
            (tree / "modules" / name).write_bytes(data)
        names = "".join(Path(file).name.removesuffix(".xz") + "\n" for file in order)
        (tree / "modules" / "order").write_text(names)
        files = "\n".join(str(path.relative_to(tree)) for path in sorted(tree.rglob("*"))) + "\n"
        archive = subprocess.run(
            ["cpio", "--quiet", "-o", "-H", "newc", "-R", "0:0"], cwd=tree, input=files.encode(), check=True,
            stdout=subprocess.PIPE,
        ).stdout  # fmt: skip
        _replace(image, archive)
    finally:
        shutil.rmtree(tree, ignore_errors=True)
    _forget_others("initramfs-*.cpio", image)
    return image


def build_python_images(target: Path, lock: Path, *, keep: bool) -> list[tuple[Path, Path]]:
    """Images of the virtual environment and of the standard library it stands on, as (image, mounted path).

    keep: take images that are there even if their inputs have changed since.
    """
    environment = Path(sys.prefix)
    standard_library = Path(sysconfig.get_paths()["stdlib"]).resolve()
    site_packages = [environment / path for path in environment.glob("lib/python*/site-packages")]
    locked = hashlib.sha256(lock.read_bytes()).hexdigest() if lock.exists() else ""
    # pip writes into these folders whenever it installs or removes something
    stamps = [str(path.stat().st_mtime_ns) for path in (environment / "bin", *site_packages)]
    environment_key = _key(str(environment), locked, *stamps)
    library_key = _key(str(standard_library), sys.version, str(standard_library.stat().st_mtime_ns))
    return [
        (_squash(environment, "environment", environment_key, [], target, keep), environment),
        (_squash(standard_library, "library", library_key, ["test", "site-packages"], target, keep), standard_library),
    ]


def _squash(source: Path, name: str, key: str, without: list[str], target: Path, keep: bool) -> Path:
    image = target / f"{name}-{key}.squashfs"
    if keep:
        image = next(target.glob(f"{name}-*.squashfs"), image)
    if image.exists():
        return image
    print(f"building an image of {source}", flush=True)
    partial = target / f"{image.name}.{os.getpid()}.partial"
    command = ["mksquashfs", str(source), str(partial), "-comp", "lz4", "-no-progress", "-quiet", "-no-xattrs"]
    try:
        subprocess.run([*command, *(["-e", *without] if without else [])], check=True, stdout=subprocess.DEVNULL)
        partial.rename(image)
    finally:
        partial.unlink(missing_ok=True)
    _forget_others(f"{name}-*.squashfs", image)
    return image


def _key(*parts: str) -> str:
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _replace(path: Path, data: bytes) -> None:
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    partial.write_bytes(data)
    partial.rename(path)


def _forget_others(pattern: str, kept: Path) -> None:
    # a guest that still runs on an old image holds it open
    for path in kept.parent.glob(pattern):
        if path != kept:
            path.unlink(missing_ok=True)

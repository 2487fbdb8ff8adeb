"""The host's side of the virtual machine, without booting one."""

import json
import lzma
import struct
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest
from guest_tests import faults_of
from run import CANNOT_RUN_HERE, NO_RESULT, TIMED_OUT, exit_code_of, main, qemu_command, run_guest
from vm_images import load_order, uncompressed_kernel
from vm_packages import NotInstallableError, install_tools, version_key

GOOD_REPORT: dict[str, Any] = {
    "bus": {"interface": "socketcan"},
    "final_state": "DISABLED",
    "leak": {"injected_at_s": 5.0, "detected_at_s": 5.4, "false_alarms": 0},
}


def test_modules_come_after_what_they_need() -> None:
    modules_dep = (
        "k/net/vcan.ko: k/can-dev.ko\nk/can-dev.ko: k/can.ko k/base.ko\nk/can.ko: k/base.ko\nk/base.ko:\nk/x.ko:\n"
    )
    order = load_order(modules_dep, "kernel/drivers/virtio-pci.ko\n", ("virtio_pci", "vcan", "can"))
    assert sorted(order) == ["k/base.ko", "k/can-dev.ko", "k/can.ko", "k/net/vcan.ko"]
    assert [order.index(f"k/{name}.ko") for name in ("base", "can", "can-dev", "net/vcan")] == [0, 1, 2, 3]


def test_unknown_module_is_an_error() -> None:
    with pytest.raises(KeyError, match="vcan"):
        load_order("k/can.ko:\n", "", ("vcan",))


def test_kernel_is_unpacked_where_the_header_says(tmp_path: Path) -> None:
    elf = b"\x7fELF" + bytes(range(256))
    payload = lzma.compress(elf) + struct.pack("<I", len(elf))  # the kernel's build adds the size
    image = bytearray(3 * 512)  # boot sector, 2 sectors of set-up
    image[0x1F1] = 2
    struct.pack_into("<II", image, 0x248, 7, len(payload))
    path = tmp_path / "vmlinuz-6.1.0-56-amd64"
    path.write_bytes(bytes(image) + b"decoder" + payload + b"what follows")
    unpacked = uncompressed_kernel(path, tmp_path)
    assert unpacked != path
    assert unpacked.read_bytes() == elf


def test_kernel_packed_otherwise_is_left_to_boot_itself(tmp_path: Path) -> None:
    path = tmp_path / "vmlinuz"
    path.write_bytes(bytes(4096))
    assert uncompressed_kernel(path, tmp_path) == path


def test_newest_kernel_is_found_by_number() -> None:
    names = ["linux-image-6.1.0-9-amd64", "linux-image-6.1.0-56-amd64", "linux-image-5.10.0-99-amd64"]
    assert max(names, key=version_key) == "linux-image-6.1.0-56-amd64"


def test_without_root_the_command_to_type_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vm_packages.which", lambda program: None if "qemu" in program else f"/usr/bin/{program}")
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    with pytest.raises(NotInstallableError, match="sudo apt-get install -y --no-install-recommends qemu-system-x86`"):
        install_tools()


def test_a_machine_without_apt_cannot_run_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr("vm_packages.which", lambda _: None)
    monkeypatch.setattr("run.cache_folder", lambda: tmp_path)
    monkeypatch.setattr("sys.argv", ["run.py"])
    assert main() == CANNOT_RUN_HERE == 77
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == 1
    assert "qemu-system-x86, kmod, squashfs-tools, cpio" in printed[0]


def test_exit_code_is_the_last_line_alone() -> None:
    assert exit_code_of("exit code 0\n") == 0
    assert exit_code_of("exit code 3") == 3
    assert exit_code_of("the exit code 0") == NO_RESULT
    assert exit_code_of("") == NO_RESULT


def test_a_command_cannot_pass_for_a_machine_without_qemu() -> None:
    assert exit_code_of("exit code 77") == 1


def _says(*lines: str, then: str = "") -> list[str]:
    return [sys.executable, "-c", f"for line in {lines!r}: print(line, flush=True)\n{then}"]


def test_guest_result_is_handed_on(capfd: pytest.CaptureFixture[str]) -> None:
    assert run_guest(_says("exit code 0", "a test failed", "exit code 4"), 60) == 4
    assert "a test failed" in capfd.readouterr().out


def test_guest_that_dies_has_no_result() -> None:
    assert run_guest(_says("exit code 0", "Kernel panic - not syncing"), 60) == NO_RESULT


def test_guest_that_hangs_is_stopped() -> None:
    start = time.monotonic()
    assert run_guest(_says("exit code 0", then="import time; time.sleep(60)"), 1) == TIMED_OUT
    assert time.monotonic() - start < 30


def test_commas_in_paths_reach_qemu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("run.which", lambda _: "/usr/bin/qemu-system-x86_64")
    command = qemu_command(Path("/k"), Path("/i"), [Path("/a,b/c.squashfs")], Path("/job,1"))
    assert "file=/a,,b/c.squashfs,format=raw,if=virtio,readonly=on" in command
    assert "local,path=/job,,1,mount_tag=job,security_model=none" in command


def test_good_report_has_no_faults() -> None:
    assert faults_of(GOOD_REPORT) == []


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("bus.interface", "servohil"),
        ("final_state", "FAULT_DISABLED"),
        ("leak.injected_at_s", None),
        ("leak.detected_at_s", None),
        ("leak.detected_at_s", 4.9),
        ("leak.false_alarms", 1),
    ],
)
def test_each_fault_of_a_report_is_told(path: str, value: Any) -> None:
    report = json.loads(json.dumps(GOOD_REPORT))
    *parents, key = path.split(".")
    place = report
    for parent in parents:
        place = place[parent]
    place[key] = value
    faults = faults_of(report)
    assert len(faults) == 1
    assert path in faults[0]


def _values(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _values(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return flat


def test_the_rig_of_the_guest_is_the_bench_but_for_its_rate() -> None:
    """A key that changes in bench.toml and not here would leave the guest testing another machine."""
    rigs = Path(__file__).resolve().parents[2] / "rigs"
    bench, guest = (_values(tomllib.loads((rigs / name).read_text())) for name in ("bench.toml", "vcan-vm.toml"))
    messages = ("Position", "PressureAB", "PressureSupplyTank", "ValveStatus", "ValveCommand")
    assert bench.keys() == guest.keys()
    assert {key for key in bench if bench[key] != guest[key]} == {
        "name", "loop.rate_hz", "bus.interface", *(f"bus.messages.{name}.period_s" for name in messages),
        "cylinder.bulk_modulus_pa", "control.c", "control.decay_per_s",
        "telemetry.listen", "telemetry.batch_s", "plant.command_timeout_s", "plant.substeps",
    }  # fmt: skip

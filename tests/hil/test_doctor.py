"""The doctor's judgement from injected facts, its probes against faults made on purpose, and all of it here."""

import os
import socket
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from servohil.hil import doctor_probes
from servohil.hil.doctor import Check, Status, doctor_lines, exit_code, judge, needs_of, run_doctor
from servohil.hil.doctor_can import CanLink
from servohil.hil.doctor_probes import (
    Machine,
    Needs,
    can_socket_error,
    channel_state,
    free_bytes,
    isolated,
    local_bus_error,
    multicast_error,
    numba_cache,
    permissions,
    port_error,
    shm_error,
    wrong_distributions,
)

ROOT = Path(__file__).resolve().parents[2]
HEALTHY = Machine(
    python=(3, 11, 7),
    wrong_distributions=(),
    asammdf_importable=False,
    can_socket_error=None,
    channel_state="up",
    can_link=CanLink(16, 100),
    multicast_error=None,
    local_bus_error=None,
    fifo_error=None,
    mlockall_error=None,
    memlock_limit_bytes=None,
    cores=4,
    governors=("performance",),
    kernel="6.1.0-rt",
    kernel_realtime=True,
    isolated="3",
    numba_cache_error=None,
    numba_cache_entries=12,
    port_error=None,
    free_bytes=10**11,
    shm_error=None,
)


def named(checks: list[Check], name: str) -> Check:
    (found,) = [check for check in checks if check.name == name]
    return found


def test_healthy_machine_has_no_complaint() -> None:
    checks = judge(HEALTHY, Needs(interface="socketcan"))
    assert {check.status for check in checks} == {"ok"}
    assert not any(check.fix for check in checks)
    assert exit_code(checks) == 0


@pytest.mark.parametrize(
    ("fault", "needs", "name", "status", "fix"),
    [
        ({"python": (3, 10, 2)}, {}, "python", "fail", "python3.11"),
        ({"wrong_distributions": ("numpy 1.26 (needs >=2.2)",)}, {}, "packages", "fail", "make setup"),
        ({"asammdf_importable": True}, {}, "asammdf", "fail", "pip uninstall asammdf"),
        ({"can_socket_error": "no"}, {}, "can in kernel", "warn", "modprobe"),
        ({"can_socket_error": "no"}, {"interface": "socketcan"}, "can in kernel", "fail", "modprobe"),
        ({"channel_state": "absent"}, {}, "can channel", "warn", "ip link add dev vcan0 type vcan"),
        ({"channel_state": "absent"}, {"interface": "socketcan"}, "can channel", "fail", "modprobe vcan"),
        (
            {"channel_state": "down"},
            {"interface": "socketcan", "channel": "can0"},
            "can channel",
            "fail",
            "can0 up type can bitrate",
        ),
        (
            {"channel_state": "not CAN"},
            {"interface": "socketcan", "channel": "lo"},
            "can channel",
            "fail",
            "ip -brief link",
        ),
        ({"local_bus_error": "Permission denied"}, {}, "embedded bus", "fail", "TMPDIR"),
        ({"local_bus_error": "Permission denied"}, {"interface": "socketcan"}, "embedded bus", "warn", "TMPDIR"),
        ({"multicast_error": "Network is unreachable"}, {}, "multicast route", "warn", "ip route add 239.0.0.0/8"),
        (
            {"multicast_error": "Network is unreachable"},
            {"interface": "udp_multicast"},
            "multicast route",
            "fail",
            "ip route add 239.0.0.0/8 dev lo",
        ),
        ({"fifo_error": "Operation not permitted"}, {}, "SCHED_FIFO", "warn", "rtprio"),
        (
            {"mlockall_error": "Cannot allocate memory", "memlock_limit_bytes": 8 << 20},
            {},
            "memory lock",
            "warn",
            "memlock",
        ),
        ({"cores": 1}, {}, "cores", "warn", "core"),
        ({"governors": ("performance", "powersave")}, {}, "cpu governor", "warn", "cpupower"),
        ({"isolated": ""}, {}, "isolated cpus", "warn", "isolcpus"),
        ({"can_link": CanLink(16, 0)}, {"channel": "can0"}, "can link", "warn", "can0 up type can restart-ms"),
        ({"can_link": CanLink(1000, None)}, {}, "can link", "warn", "vcan0 txqueuelen 16"),
        ({"kernel_realtime": False}, {}, "kernel", "warn", "linux-image-rt"),
        ({"numba_cache_error": "Read-only file system"}, {}, "compile cache", "fail", "NUMBA_CACHE_DIR"),
        ({"numba_cache_entries": 0}, {}, "compile cache", "warn", "hil bench --lockstep"),
        ({"port_error": "already in use"}, {}, "zenoh port", "fail", "sport = :7447"),
        ({"free_bytes": 9 * 10**8}, {}, "disk", "warn", "space"),
        ({"free_bytes": 2 * 10**8}, {}, "disk", "fail", "space"),
        ({"shm_error": "No such file or directory"}, {}, "shared memory", "fail", "mount"),
    ],
)
def test_each_fault_moves_its_own_check_and_no_other(
    fault: dict[str, object], needs: dict[str, str], name: str, status: Status, fix: str
) -> None:
    checks = judge(replace(HEALTHY, **fault), Needs(**needs))  # type: ignore[arg-type]
    check = named(checks, name)
    assert check.status == status
    assert fix in check.fix
    assert check.fix
    assert {other.status for other in checks if other is not check} == {"ok"}
    assert exit_code(checks) == (status == "fail")


def test_lines_align_and_carry_the_fix() -> None:
    checks = [Check("cores", "ok", "4"), Check("disk", "fail", "0.1 GB free", "free some space")]
    assert doctor_lines(checks) == [
        "ok    cores            4",
        "fail  disk             0.1 GB free",
        "                       fix: free some space",
    ]


def test_limit_is_named_where_memory_cannot_be_locked() -> None:
    checks = judge(replace(HEALTHY, mlockall_error="no", memlock_limit_bytes=8 << 20), Needs())
    assert "RLIMIT_MEMLOCK 8 MB" in named(checks, "memory lock").reason


def test_missing_and_outdated_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    assert wrong_distributions() == ()
    wanted = ["numpy>=99", "no-such-package>=1", "click>=8", "absent-dev-tool; extra == 'dev'"]
    monkeypatch.setattr(doctor_probes, "requires", lambda _: wanted)
    outdated, missing = wrong_distributions()
    assert outdated.startswith("numpy ")
    assert "(needs >=99)" in outdated
    assert missing == "no-such-package missing"


def test_channel_states(tmp_path: Path) -> None:
    for name, kind, flags in (("can0", "280", "0x40081"), ("can1", "280", "0x40080"), ("eth0", "1", "0x1003")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "type").write_text(f"{kind}\n")
        (tmp_path / name / "flags").write_text(f"{flags}\n")
    states = {name: channel_state(name, tmp_path) for name in ("can0", "can1", "eth0", "can9", "", "../x")}
    assert states == {"can0": "up", "can1": "down", "eth0": "not CAN", "can9": "absent", "": "absent", "../x": "absent"}
    assert channel_state("lo") == "not CAN"


def test_isolated_processors(tmp_path: Path) -> None:
    (tmp_path / "isolated").write_text("2-3\n")
    assert isolated(tmp_path / "isolated") == "2-3"
    (tmp_path / "isolated").write_text("\n")
    assert isolated(tmp_path / "isolated") == isolated(tmp_path / "absent") == ""


def test_port_in_use_is_seen_and_a_probe_leaves_it_free() -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen(1)
        end_point = f"tcp/127.0.0.1:{holder.getsockname()[1]}"
        assert port_error(end_point) == "already in use"
    assert port_error(end_point) is None
    assert port_error(end_point) is None
    assert port_error("tcp/[::1]:0") in {None, "Cannot assign requested address", "Address family not supported"}
    assert port_error("unixsock-stream//tmp/x") is None
    for malformed in ("tcp/127.0.0.1:http", "tcp/127.0.0.1:70000", "tcp/127.0.0.1:-1", "tcp/:7447", "tcp/x"):
        assert "not of the form" in str(port_error(malformed)), malformed


def test_cache_folder(tmp_path: Path) -> None:
    assert numba_cache(tmp_path / "not" / "yet") == (None, 0)
    assert not (tmp_path / "not").exists()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "f.py311.nbi").touch()
    (tmp_path / "sub" / "f.py311.1.nbc").touch()
    assert numba_cache(tmp_path) == (None, 1)
    assert numba_cache(Path("/proc/nowhere"))[0] is not None  # not even root writes there


def test_disk_of_a_folder_yet_to_be_made(tmp_path: Path) -> None:
    stat = os.statvfs(tmp_path)
    assert free_bytes(tmp_path / "runs" / "x") == pytest.approx(stat.f_bavail * stat.f_frsize, rel=0.05)


def test_shared_memory(tmp_path: Path) -> None:
    assert shm_error(str(tmp_path)) is None
    assert shm_error(str(tmp_path / "absent")) == "No such file or directory"
    assert list(tmp_path.iterdir()) == []


def test_local_bus(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert local_bus_error() is None
    monkeypatch.setattr(doctor_probes.tempfile, "tempdir", str(tmp_path / "absent"))
    assert local_bus_error() == "No such file or directory"


def test_multicast() -> None:
    assert multicast_error("127.0.0.1") == "Invalid argument"  # not a group
    routed = any(row.split()[1] == "00000000" for row in Path("/proc/net/route").read_text().splitlines()[1:])
    assert not routed or multicast_error() is None


def test_can_socket_agrees_with_the_kernel() -> None:
    error = can_socket_error()  # first: opening the socket loads the module
    assert (error is None) == ("CAN_RAW" in Path("/proc/net/protocols").read_text())


def test_permissions_leave_this_process_alone() -> None:
    before = os.sched_getscheduler(0)
    fifo, mlockall = permissions(50)
    assert os.sched_getscheduler(0) == before
    assert all(error is None or isinstance(error, str) for error in (fifo, mlockall))
    assert permissions(1000)[0] == "Invalid argument"  # beyond any SCHED_FIFO priority


def test_permissions_without_rights_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    give_up_rights = """
import resource
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (1 << 20, 1 << 20))
if os.getuid() == 0:
    os.setuid(65534)
found = {}
"""
    script = doctor_probes.PERMISSIONS_PROBE.replace("found = {}\n", give_up_rights)
    assert script != doctor_probes.PERMISSIONS_PROBE
    monkeypatch.setattr(doctor_probes, "PERMISSIONS_PROBE", script)
    fifo, mlockall = permissions(50)
    assert fifo == "Operation not permitted"
    assert mlockall in {"Cannot allocate memory", "Operation not permitted"}


def test_permissions_probe_that_dies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    fifo, mlockall = permissions(50)
    assert fifo == mlockall == "the probe process failed: CalledProcessError"


def test_needs_follow_the_rig_file() -> None:
    from servohil.hil.config import load_rig

    rig = load_rig(ROOT / "rigs" / "bench.toml")
    assert needs_of(rig) == Needs()


def test_this_machine() -> None:
    checks = run_doctor()
    assert len({check.name for check in checks}) == len(checks) >= 14
    assert named(checks, "python").status == "ok"
    assert named(checks, "packages").status == "ok"
    assert named(checks, "asammdf").status == "ok"
    assert all(check.fix for check in checks if check.status != "ok")
    assert all("\n" not in line for line in doctor_lines(checks))

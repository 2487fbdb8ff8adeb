"""`hil doctor`: is this machine fit for the rig? One line per check: ok, warn or fail, why, and the command that helps.

"fail" is what keeps `hil run` from starting with this configuration; "warn" is what makes it worse than it could be.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from servohil.drivers.can_network import MULTICAST_ROUTE_COMMAND, bring_up_command
from servohil.hil.doctor_can import complaints
from servohil.hil.doctor_probes import CONTROLLER_ADDRESS_SPACE_BYTES, Machine, Needs, probe

if TYPE_CHECKING:
    from servohil.hil.config import Rig  # pydantic: not needed to look at a machine

Status = Literal["ok", "warn", "fail"]
LEAST_PYTHON: Final = (3, 11)
REALTIME_LIMITS: Final = (
    "printf '@servohil - rtprio 90\\n@servohil - memlock unlimited\\n' | sudo tee /etc/security/limits.d/servohil.conf"
    " && sudo groupadd -f servohil && sudo usermod -aG servohil $USER  # then log in again"
)
ISOLATE: Final = (
    "add isolcpus=managed_irq,domain,3 nohz_full=3 irqaffinity=0-2 to the kernel's command line (docs/deploy.md)"
)


@dataclass(frozen=True)
class Check:
    """One line of the doctor. `fix` is a command or a sentence, empty where nothing is wrong."""

    name: str
    status: Status
    reason: str
    fix: str = ""


def needs_of(rig: "Rig") -> Needs:
    """What a rig's configuration asks of the machine."""
    return Needs(
        interface=rig.bus.interface,
        channel=rig.bus.channel,
        priority=rig.loop.priority,
        listen=rig.telemetry.listen,
        recording_directory=rig.recording.directory,
        rotate_bytes=rig.recording.rotate_bytes,
    )


def _software(machine: Machine) -> list[Check]:
    version = ".".join(map(str, machine.python))
    install = "make setup"
    wrong = machine.wrong_distributions
    return [
        Check("python", "ok", version)
        if machine.python[:2] >= LEAST_PYTHON
        else Check("python", "fail", f"{version}: needs >= 3.11", "sudo apt install python3.11 python3.11-venv"),
        Check("packages", "fail", "; ".join(wrong), install)
        if wrong
        else Check("packages", "ok", "all requirements met"),
        Check(
            "asammdf",
            "fail",
            "importable: `import can` then loads pandas and starts threads in the controller",
            "pip uninstall asammdf  # MF4 export runs in an environment of its own",
        )
        if machine.asammdf_importable
        else Check("asammdf", "ok", "not importable here, as it should be"),
    ]


def _channel_fix(channel: str, state: str) -> str:
    if state == "not CAN":
        return "set bus.channel to a CAN interface: ip -brief link"
    if not channel.startswith("vcan"):
        return bring_up_command(channel)
    return f"sudo ip link set up {channel}" if state == "down" else f"sudo modprobe vcan && {bring_up_command(channel)}"


def _bus(machine: Machine, needs: Needs) -> list[Check]:
    wanted = needs.interface == "socketcan"
    missing: Status = "fail" if wanted else "warn"
    instead = "" if wanted else f"; {needs.interface!r} does without it"
    checks = []
    if machine.can_socket_error is None:
        checks.append(Check("can in kernel", "ok", "AF_CAN sockets open"))
        if machine.channel_state == "up":
            checks.append(Check("can channel", "ok", f"{needs.channel} is up"))
        else:
            reason = f"{needs.channel} is {machine.channel_state}{instead}"
            checks.append(Check("can channel", missing, reason, _channel_fix(needs.channel, machine.channel_state)))
    else:
        fix = "sudo modprobe can-raw vcan  # or a kernel with CONFIG_CAN"
        checks.append(Check("can in kernel", missing, f"AF_CAN: {machine.can_socket_error}{instead}", fix))
    if machine.can_link is not None:
        wrong = complaints(needs.channel, machine.can_link)
        checks += [Check("can link", "warn", f"{needs.channel} {why}", fix) for why, fix in wrong]
        if not wrong:
            checks.append(
                Check("can link", "ok", f"{needs.channel} comes back after a bus-off, and its queue is short")
            )
    if machine.local_bus_error is None:
        checks.append(Check("embedded bus", "ok", "Unix datagram sockets pass frames"))
    else:
        status: Status = "fail" if needs.interface in {"auto", "servohil"} else "warn"
        fix = "export TMPDIR=<a folder you may write>"
        checks.append(Check("embedded bus", status, machine.local_bus_error, fix))
    if machine.multicast_error is None:
        checks.append(Check("multicast route", "ok", "239.0.0.0/8 is routed"))
    elif needs.interface == "udp_multicast":
        checks.append(Check("multicast route", "fail", machine.multicast_error, MULTICAST_ROUTE_COMMAND))
    else:
        reason = f"{machine.multicast_error}; only interface 'udp_multicast' needs it"
        checks.append(Check("multicast route", "warn", reason, MULTICAST_ROUTE_COMMAND))
    return checks


def _realtime(machine: Machine, needs: Needs) -> list[Check]:
    checks = []
    if machine.fifo_error is None:
        checks.append(Check("SCHED_FIFO", "ok", f"priority {needs.priority} granted"))
    else:
        reason = f"priority {needs.priority}: {machine.fifo_error}; the loop then wakes later and less evenly"
        checks.append(Check("SCHED_FIFO", "warn", reason, REALTIME_LIMITS))
    size = f"{CONTROLLER_ADDRESS_SPACE_BYTES >> 20} MB"
    limit = machine.memlock_limit_bytes
    if machine.mlockall_error is None:
        checks.append(Check("memory lock", "ok", f"mlockall granted for {size}"))
    else:
        stated = "unlimited" if limit is None else f"{limit / 2**20:.0f} MB"
        reason = (
            f"mlockall of {size}: {machine.mlockall_error} (RLIMIT_MEMLOCK {stated}); a page fault can delay a cycle"
        )
        checks.append(Check("memory lock", "warn", reason, REALTIME_LIMITS))
    if machine.cores >= 2:
        checks.append(Check("cores", "ok", f"{machine.cores}"))
    else:
        reason = "1: controller, telemetry and actuator node share it"
        checks.append(Check("cores", "warn", reason, "give the machine a second core, or lower loop.rate_hz"))
    slow = [governor for governor in machine.governors if governor != "performance"]
    if slow:
        fix = "sudo cpupower frequency-set -g performance"
        checks.append(Check("cpu governor", "warn", f"{', '.join(slow)}: the clock drops between cycles", fix))
    else:
        reason = "performance" if machine.governors else "the kernel scales no frequency here (virtual machine?)"
        checks.append(Check("cpu governor", "ok", reason))
    if machine.kernel_realtime:
        checks.append(Check("kernel", "ok", f"{machine.kernel}, PREEMPT_RT"))
    else:
        reason = f"{machine.kernel} is not PREEMPT_RT: wake-ups can come milliseconds late"
        checks.append(Check("kernel", "warn", reason, "sudo apt install linux-image-rt-amd64  # then reboot"))
    if machine.isolated:
        checks.append(Check("isolated cpus", "ok", machine.isolated))
    else:
        reason = "none: any other program may run where the loop does"
        checks.append(Check("isolated cpus", "warn", reason, ISOLATE))
    return checks


def _resources(machine: Machine, needs: Needs) -> list[Check]:
    checks = []
    if machine.numba_cache_error is not None:
        fix = "export NUMBA_CACHE_DIR=<a folder you may write>"
        checks.append(Check("compile cache", "fail", f"cannot be written: {machine.numba_cache_error}", fix))
    elif machine.numba_cache_entries == 0:
        fix = "hil bench --lockstep --duration 1"
        checks.append(Check("compile cache", "warn", "cold: the next start compiles first", fix))
    else:
        checks.append(Check("compile cache", "ok", f"warm, {machine.numba_cache_entries} functions"))
    if machine.port_error is None:
        checks.append(Check("zenoh port", "ok", f"{needs.listen} is free"))
    else:
        port = needs.listen.rpartition(":")[2]
        fix = f"ss -ltnp 'sport = :{port}'  # shows who; or change telemetry.listen"
        checks.append(Check("zenoh port", "fail", f"{needs.listen}: {machine.port_error}", fix))
    free = f"{machine.free_bytes / 1e9:.1f} GB free, recordings rotate at {needs.rotate_bytes / 1e9:.2f} GB"
    fix = "free some space, or change recording.directory"
    if machine.free_bytes < needs.rotate_bytes:
        checks.append(Check("disk", "fail", free, fix))
    elif machine.free_bytes < 4 * needs.rotate_bytes:
        checks.append(Check("disk", "warn", free, fix))
    else:
        checks.append(Check("disk", "ok", free))
    if machine.shm_error is None:
        checks.append(Check("shared memory", "ok", "/dev/shm is writable"))
    else:
        fix = "sudo mount -t tmpfs -o mode=1777 tmpfs /dev/shm"
        checks.append(Check("shared memory", "fail", f"/dev/shm: {machine.shm_error}", fix))
    return checks


def judge(machine: Machine, needs: Needs) -> list[Check]:
    """All checks of a machine against what a configuration needs, in the order in which they are printed. Pure."""
    return [*_software(machine), *_bus(machine, needs), *_realtime(machine, needs), *_resources(machine, needs)]


def run_doctor(rig: "Rig | None" = None) -> list[Check]:
    """Look at this machine and judge it for `rig`, or for the bench without one."""
    needs = Needs() if rig is None else needs_of(rig)
    checks = judge(probe(needs), needs)
    if rig is not None and rig.credentials_path is not None:
        from servohil.hil.secure.doctor import credential_check

        checks.append(credential_check(rig.credentials_path))
    return checks


def doctor_lines(checks: Iterable[Check]) -> list[str]:
    """The checks as text: status, name, reason; the fix on a line of its own below."""
    lines = []
    for check in checks:
        lines.append(f"{check.status:<4}  {check.name:<15}  {check.reason}")
        if check.fix:
            lines.append(f"{'':<23}fix: {check.fix}")
    return lines


def exit_code(checks: Iterable[Check]) -> int:
    """1 where any check failed, else 0: warnings do not stop anybody."""
    return int(any(check.status == "fail" for check in checks))

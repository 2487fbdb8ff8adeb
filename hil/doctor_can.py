"""`hil doctor` on a CAN interface: does it come back after a bus-off, and is its queue short? `deploy/` sets both.

Looks only: the kernel's files and `ip -json link show`. A virtual interface has no bus and no bus-off.
"""

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

LONGEST_QUEUE: Final = 16  # frames; at 1 Mbit/s they are 2 ms of old commands
RESTART_MS: Final = 100
IP_TIMEOUT_S: Final = 5.0
CLASS_NET: Final = Path("/sys/class/net")


@dataclass(frozen=True)
class CanLink:
    """How an interface is set. None where the system does not say."""

    queue: int | None
    restart_ms: int | None  # 0: stays down after a bus-off; None too where there is no bus


def can_link(channel: str, class_net: Path = CLASS_NET) -> CanLink | None:
    """The settings of an existing network interface; None where there is none of that name."""
    folder = class_net / channel
    if not channel or "/" in channel or not folder.is_dir():
        return None
    try:
        queue: int | None = int((folder / "tx_queue_len").read_text())
    except (OSError, ValueError):
        queue = None
    try:
        done = subprocess.run(
            ["ip", "-json", "-details", "link", "show", "dev", channel],
            capture_output=True, text=True, timeout=IP_TIMEOUT_S, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return CanLink(queue, None)
    return CanLink(queue, restart_ms(done.stdout))


def restart_ms(output: str) -> int | None:
    """`restart_ms` in what `ip -json -details link show` printed; None without a bus, or in no shape we know."""
    try:
        (interface,) = json.loads(output)
        info: dict[str, Any] = interface["linkinfo"]
        return int(info["info_data"]["restart_ms"]) if info["info_kind"] == "can" else None
    except (ValueError, TypeError, KeyError):
        return None


def complaints(channel: str, link: CanLink) -> list[tuple[str, str]]:
    """(what is wrong, command that helps) for each setting that is not as it should be."""
    found = []
    if link.restart_ms == 0:
        why = "stays off after a bus-off until somebody restarts it (restart-ms 0)"
        found.append(
            (why, f"sudo ip link set {channel} down && sudo ip link set {channel} up type can restart-ms {RESTART_MS}")
        )
    if link.queue is not None and link.queue > LONGEST_QUEUE:
        why = f"queues {link.queue} frames: an old command is worse than a dropped one"
        found.append((why, f"sudo ip link set {channel} txqueuelen {LONGEST_QUEUE}"))
    return found

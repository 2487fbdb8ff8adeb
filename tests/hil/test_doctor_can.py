"""What the doctor reads of a CAN interface, from what `ip` prints and from the kernel's files."""

from pathlib import Path

import pytest

from servohil.hil import doctor_can
from servohil.hil.doctor_can import CanLink, can_link, complaints, restart_ms

# Shape of `ip -json -details link show dev can0` (iproute2 6.1), cut to what is looked at.
CAN0 = '[{"ifname":"can0","txqlen":10,"linkinfo":{"info_kind":"can","info_data":{"restart_ms":%d}}}]'
VCAN0 = '[{"ifname":"vcan0","linkinfo":{"info_kind":"vcan"}}]'


@pytest.mark.parametrize(
    ("output", "expected"),
    [
        (CAN0 % 100, 100),
        (CAN0 % 0, 0),
        (VCAN0, None),
        ("", None),
        ("[]", None),
        ("[{}]", None),
        ('[{"linkinfo": 3}]', None),
    ],
)
def test_restart_time_in_the_words_of_ip(output: str, expected: int | None) -> None:
    assert restart_ms(output) == expected


def test_what_is_wrong_with_a_link() -> None:
    assert complaints("can0", CanLink(10, 100)) == complaints("vcan0", CanLink(16, None)) == []
    assert complaints("can0", CanLink(None, None)) == []
    ((why, fix),) = complaints("can0", CanLink(17, 1))
    assert "17 frames" in why and fix == "sudo ip link set can0 txqueuelen 16"
    assert len(complaints("can0", CanLink(1000, 0))) == 2


def test_an_interface_is_looked_at_and_none_is_made_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "can0").mkdir()
    (tmp_path / "can0" / "tx_queue_len").write_text("10\n")
    assert can_link("can9", tmp_path) is None
    assert can_link("", tmp_path) is None
    assert can_link("../can0", tmp_path) is None
    monkeypatch.setenv("PATH", str(tmp_path))  # no program `ip` here
    assert can_link("can0", tmp_path) == CanLink(10, None)
    (tmp_path / "can0" / "tx_queue_len").unlink()
    assert can_link("can0", tmp_path) == CanLink(None, None)
    program = tmp_path / "ip"
    program.write_text(f"#!/bin/sh\necho '{CAN0 % 250}'\n")
    program.chmod(0o755)
    assert can_link("can0", tmp_path) == CanLink(None, 250)


def test_the_default_is_the_kernels_folder() -> None:
    assert str(doctor_can.CLASS_NET) == "/sys/class/net"
    assert can_link("lo") is not None

"""CAN FD messages in a DBC: what makes one, which lengths there are, and where profile 5 wants its signals."""

from pathlib import Path

import cantools
import pytest
from bench_bus import FD_DBC, FD_PROTECTIONS, PROTECTIONS
from test_dbc import PLAIN, dbc_with, message, refused

from servohil.drivers.dbc import load_messages
from servohil.drivers.e2e import MessageProtection
from servohil.drivers.frame import FLAG_BRS, FLAG_FD

FORMATS = ['"StandardCAN"', '"ExtendedCAN"', *['"reserved"'] * 12, '"StandardCAN_FD"', '"ExtendedCAN_FD"']
FD = f'BA_DEF_ BO_ "VFrameFormat" ENUM {",".join(FORMATS)};\nBA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
FD_M = FD + 'BA_ "VFrameFormat" BO_ 256 14;\n'
BRS = 'BA_DEF_ BO_ "CANFD_BRS" ENUM "0","1";\nBA_DEF_DEF_ "CANFD_BRS" "{}";\n'
PROFILE5 = {"M": MessageProtection(1_000_000, "profile5", (0x1234,))}
CRC = 'crc : 0|16@1+ (1,0) [0|0] ""'
COUNTER = 'counter : 16|8@1+ (1,0) [0|0] ""'
X = 'x : 24|8@1+ (1,0) [0|0] ""'


def test_the_fd_bench_has_what_the_rig_needs() -> None:
    sensors, command = load_messages(FD_DBC, FD_PROTECTIONS, ["Actuator", "ValveCommand"])
    assert (sensors.frame_id, sensors.length, sensors.flags) == (0x120, 32, FLAG_FD | FLAG_BRS)
    assert (command.frame_id, command.length, command.flags) == (0x0A0, 8, FLAG_FD | FLAG_BRS)
    assert [signal.name for signal in command.signals] == ["control_word", "command"]
    assert {signal.gain for signal in sensors.signals} == {1.0, 1e-6, 10.0, 1e-3}  # 0.0001 bar are 10 Pa


def test_the_fd_bench_documents_itself() -> None:
    for m in cantools.database.load_file(FD_DBC).messages:
        assert m.comment and m.is_fd and m.cycle_time == 1
        assert all(s.comment and s.minimum is not None and s.maximum is not None for s in m.signals)


@pytest.mark.parametrize("length", [1, 3, 8, 12, 16, 20, 24, 32, 48, 64])
def test_lengths_of_fd_frames(tmp_path: Path, length: int) -> None:
    path = dbc_with(tmp_path, message(f'x : {8 * length - 8}|8@1+ (1,0) [0|0] ""', length=length) + FD_M)
    assert load_messages(path, PLAIN, ["M"])[0].length == length
    if length > 8:
        classic = dbc_with(tmp_path, message(length=length) + FD)
        refused(classic, '"M"', f"{length} data bytes", "VFrameFormat", "StandardCAN_FD")


@pytest.mark.parametrize("length", [0, 9, 30, 33, 63])
def test_lengths_that_no_fd_frame_has(tmp_path: Path, length: int) -> None:
    refused(
        dbc_with(tmp_path, message(length=length) + FD_M), f"{length} data bytes", "1 to 8, 12, 16, 20, 24, 32, 48, 64"
    )


def test_an_extended_fd_message(tmp_path: Path) -> None:
    refused(
        dbc_with(tmp_path, message(X, frame_id=0x80000100) + FD + 'BA_ "VFrameFormat" BO_ 2147483904 15;\n'), "extended"
    )


@pytest.mark.parametrize(
    ("attributes", "flags"),
    [
        ("", FLAG_FD | FLAG_BRS),
        (BRS.format(1), FLAG_FD | FLAG_BRS),
        (BRS.format(0), FLAG_FD),
        (BRS.format(1) + 'BA_ "CANFD_BRS" BO_ 256 0;\n', FLAG_FD),
        (BRS.format(0) + 'BA_ "CANFD_BRS" BO_ 256 1;\n', FLAG_FD | FLAG_BRS),
    ],
)
def test_the_bit_rate_switch_is_the_files(tmp_path: Path, attributes: str, flags: int) -> None:
    assert load_messages(dbc_with(tmp_path, message(X) + FD_M + attributes), PLAIN, ["M"])[0].flags == flags
    classic = dbc_with(tmp_path, message(X) + FD + attributes)
    assert load_messages(classic, PLAIN, ["M"])[0].flags == 0


@pytest.mark.parametrize("attributes", ["", FD_M])
def test_profile5_in_its_place_is_taken_on_either_bus(tmp_path: Path, attributes: str) -> None:
    path = dbc_with(tmp_path, message(CRC, COUNTER, X) + attributes)
    assert [s.name for s in load_messages(path, PROFILE5, ["M"])[0].signals] == ["x"]


@pytest.mark.parametrize(
    ("signals", "said"),
    [
        ([COUNTER], 'no signal "crc", which e2e = "profile5" needs (start 0, 16 bits)'),
        ([CRC], 'no signal "counter", which e2e = "profile5" needs (start 16, 8 bits)'),
        ([CRC.replace("0|16", "0|8"), COUNTER], 'signal "crc": start 0, 8 bits'),
        ([CRC.replace("0|16@1", "7|16@0"), COUNTER], 'signal "crc": start 7, 16 bits, big-endian'),
        ([CRC, COUNTER.replace("16|8", "24|8")], 'signal "counter": start 24'),
        ([CRC, COUNTER.replace("16|8", "16|4")], 'signal "counter": start 16, 4 bits'),
        ([CRC, COUNTER.replace("8@1+", "8@1-")], "unsigned"),
    ],
)
def test_profile5_out_of_place(tmp_path: Path, signals: list[str], said: str) -> None:
    refused(dbc_with(tmp_path, message(*signals, length=12) + FD_M), '"M"', said, protections=PROFILE5)


def test_profile2_is_not_for_long_frames(tmp_path: Path) -> None:
    two = ('crc : 0|8@1+ (1,0) [0|0] ""', 'counter : 8|4@1+ (1,0) [0|0] ""')
    protections = {"M": PROTECTIONS["Position"]}
    refused(
        dbc_with(tmp_path, message(*two, length=12) + FD_M), "12 data bytes", '"profile2" is for 1 to 8', '"profile5"',
        protections=protections,
    )  # fmt: skip
    assert load_messages(dbc_with(tmp_path, message(*two) + FD_M), protections, ["M"])[0].flags & FLAG_FD

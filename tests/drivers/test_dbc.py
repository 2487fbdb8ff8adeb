"""Every way a DBC can be wrong gets one line that says where, what, and what is allowed."""

import re
from pathlib import Path

import pytest
from bench_bus import BENCH_DBC, COMMAND, PROTECTIONS, SENSOR_MESSAGES

from servohil.drivers.codec import load_codec
from servohil.drivers.dbc import SI_FACTORS, DbcError, load_messages
from servohil.drivers.e2e import MessageProtection

PLAIN = {"M": MessageProtection(1_000_000, "none")}
NAMES = (*SENSOR_MESSAGES, COMMAND)


def dbc_with(tmp_path: Path, body: str, encoding: str = "cp1252") -> Path:
    path = tmp_path / "rig.dbc"
    path.write_text('VERSION ""\nNS_ :\nBS_:\nBU_: A B\n' + body, encoding=encoding)
    return path


def message(*signals: str, length: int = 8, frame_id: int = 256, name: str = "M") -> str:
    return f"BO_ {frame_id} {name}: {length} A\n" + "".join(f" SG_ {signal} B\n" for signal in signals)


def refused(path: Path, *said: str, protections: dict[str, MessageProtection] = PLAIN, names: tuple = ("M",)) -> None:
    with pytest.raises(DbcError) as caught:
        load_messages(path, protections, names)
    text = str(caught.value)
    assert "\n" not in text
    assert str(path) in text
    for part in said:
        assert part in text, text


def test_the_bench_file_has_what_the_rig_needs() -> None:
    tables = load_messages(BENCH_DBC, PROTECTIONS, NAMES)
    assert [table.frame_id for table in tables] == [0x121, 0x122, 0x123, 0x120, 0x0A0]
    assert {table.length for table in tables} == {8}
    signals = {f"{table.name}.{signal.name}": signal for table in tables for signal in table.signals}
    gains = {name: (signal.gain, signal.bias, signal.length, signal.signed) for name, signal in signals.items()}
    assert gains == {
        "Position.position": (1e-6, 0.0, 32, True),
        "PressureAB.pressure_a": (1e3, 0.0, 16, True),
        "PressureAB.pressure_b": (1e3, 0.0, 16, True),
        "PressureSupplyTank.supply": (1e3, 0.0, 16, True),
        "PressureSupplyTank.tank": (1e3, 0.0, 16, True),
        "ValveStatus.spool": (1e-3, 0.0, 16, True),
        "ValveStatus.status_word": (1.0, 0.0, 8, False),
        "ValveCommand.command": (1e-3, 0.0, 16, True),
        "ValveCommand.control_word": (1.0, 0.0, 8, False),
    }
    assert (signals["Position.position"].raw_min, signals["Position.position"].raw_max) == (-50_000, 650_000)


def test_the_bench_file_documents_itself() -> None:
    import cantools

    database = cantools.database.load_file(BENCH_DBC)
    assert {m.cycle_time for m in database.messages} == {1}
    for m in database.messages:
        assert m.comment
        assert all(s.comment and s.minimum is not None and s.maximum is not None for s in m.signals)


def test_missing_file(tmp_path: Path) -> None:
    refused(tmp_path / "nowhere.dbc", "no such DBC file")


def test_missing_message_lists_those_there_are(tmp_path: Path) -> None:
    path = dbc_with(tmp_path, message('x : 0|8@1+ (1,0) [0|0] ""', name="Other"))
    refused(path, '"M"', '"Other"')


def test_missing_signal_lists_those_there_are() -> None:
    codec = load_codec(BENCH_DBC, PROTECTIONS, SENSOR_MESSAGES, [COMMAND])
    with pytest.raises(DbcError, match=r'bench\.dbc: no signal "Position\.speed".*Position\.position'):
        codec.slot("Position.speed")
    with pytest.raises(DbcError, match=r'no message "Force".*Position'):
        codec.message_index("Force")


def test_message_without_protection(tmp_path: Path) -> None:
    path = dbc_with(tmp_path, message('x : 0|8@1+ (1,0) [0|0] ""'))
    refused(path, '"M"', "protection", protections={})


def test_message_listed_twice() -> None:
    with pytest.raises(DbcError, match='"Position" is listed more than once'):
        load_codec(BENCH_DBC, PROTECTIONS, ["Position"], ["Position"])


def test_zero_scale(tmp_path: Path) -> None:
    path = dbc_with(tmp_path, message('x : 0|8@1+ (0,0) [0|0] ""'))
    refused(path, '"M"', '"x"', "scale 0")


def test_duplicate_frame_id(tmp_path: Path) -> None:
    signal = 'x : 0|8@1+ (1,0) [0|0] ""'
    refused(dbc_with(tmp_path, message(signal) + message(signal, name="N")), '"M"', '"N"', "0x100")


def test_duplicate_message_name(tmp_path: Path) -> None:
    signal = 'x : 0|8@1+ (1,0) [0|0] ""'
    refused(dbc_with(tmp_path, message(signal) + message(signal, frame_id=257)), 'two messages are called "M"')


def test_duplicate_signal_name(tmp_path: Path) -> None:
    path = dbc_with(tmp_path, message('x : 0|8@1+ (1,0) [0|0] ""', 'x : 8|8@1+ (1,0) [0|0] ""'))
    refused(path, '"M"', 'two signals are called "x"')


@pytest.mark.parametrize("text", ["", "VERSION", 'VERSION ""\n', "\x00\x01", "BO_ 1 M: 8 A\n SG_ x : 0|8@1+ (1,0"])
def test_files_that_are_no_dbc(tmp_path: Path, text: str) -> None:
    path = tmp_path / "cut.dbc"
    path.write_text(text)
    refused(path)


def test_cut_off_anywhere_is_an_error_or_harmless(tmp_path: Path) -> None:
    """Cut at many places: refused, or every message and signal that the rig uses is as in the whole file."""
    whole = load_messages(BENCH_DBC, PROTECTIONS, NAMES)
    wanted = [f"{table.name}.{signal.name}" for table in whole for signal in table.signals]
    content = BENCH_DBC.read_bytes()
    path = tmp_path / "cut.dbc"
    outcomes = {"refused": 0, "same": 0}
    # 23 is prime to the lengths of the lines: the cuts fall everywhere in a line.
    for size in range(0, len(content), 23):
        path.write_bytes(content[:size])
        try:
            codec = load_codec(path, PROTECTIONS, SENSOR_MESSAGES, [COMMAND])
            for name in wanted:
                codec.slot(name)
        except DbcError as error:
            assert str(path) in str(error)
            outcomes["refused"] += 1
        else:
            assert load_messages(path, PROTECTIONS, NAMES) == whole
            outcomes["same"] += 1
    assert min(outcomes.values()) > 10


@pytest.mark.parametrize("damage", ["(1,0", "(1;0)", "(,0)", "(1,0) 0|0", "(1,0) [0|0] bar"])
def test_a_malformed_signal_is_not_left_out_silently(tmp_path: Path, damage: str) -> None:
    whole = 'y : 8|8@1+ (1,0) [0|0] ""'
    refused(dbc_with(tmp_path, message(f"x : 0|8@1+ {damage}", whole) + message(whole, frame_id=257, name="N")))


def test_unknown_unit(tmp_path: Path) -> None:
    path = dbc_with(tmp_path, message('x : 0|8@1+ (1,0) [0|0] "furlong"'))
    refused(path, '"x"', '"furlong"', '"bar"', '"mm"')


@pytest.mark.parametrize("unit", SI_FACTORS)
def test_known_units_become_si(tmp_path: Path, unit: str) -> None:
    path = dbc_with(tmp_path, message(f'x : 0|8@1+ (0.5,-3) [0|0] "{unit}"'))
    signal = load_messages(path, PLAIN, ["M"])[0].signals[0]
    assert (signal.gain, signal.bias) == (0.5 * SI_FACTORS[unit], -3 * SI_FACTORS[unit])


def test_multiplexed_signals(tmp_path: Path) -> None:
    path = dbc_with(tmp_path, message('s M : 0|8@1+ (1,0) [0|0] ""', 'x m0 : 8|8@1+ (1,0) [0|0] ""'))
    refused(path, '"M"', "multiplexed")


@pytest.mark.parametrize(("start", "length", "order"), [(57, 8, 1), (0, 65, 1), (56, 9, 0), (3, 16, 1)])
def test_signal_beyond_the_frame(tmp_path: Path, start: int, length: int, order: int) -> None:
    path = dbc_with(tmp_path, message(f'x : {start}|{length}@{order}+ (1,0) [0|0] ""', length=2 if start == 3 else 8))
    refused(path, '"x"', f"start {start}", "beyond")


@pytest.mark.parametrize("second", ["4|8@1+", "7|2@0+"])
def test_overlapping_signals(tmp_path: Path, second: str) -> None:
    path = dbc_with(tmp_path, message('x : 0|8@1+ (1,0) [0|0] ""', f'y : {second} (1,0) [0|0] ""'))
    refused(path, '"x"', '"y"', "overlap")


PROFILE2 = {"M": PROTECTIONS["Position"]}
CRC = 'crc : 0|8@1+ (1,0) [0|255] ""'
COUNTER = 'counter : 8|4@1+ (1,0) [0|15] ""'


def test_profile2_in_its_place_is_taken_in_either_byte_order(tmp_path: Path) -> None:
    for crc in (CRC, CRC.replace("0|8@1", "7|8@0")):
        path = dbc_with(tmp_path, message(crc, COUNTER, 'x : 12|4@1+ (1,0) [0|0] ""'))
        assert [s.name for s in load_messages(path, PROFILE2, ["M"])[0].signals] == ["x"]


@pytest.mark.parametrize(
    ("signals", "said"),
    [
        ([COUNTER], 'no signal "crc"'),
        ([CRC], 'no signal "counter"'),
        ([CRC.replace("0|8", "56|8"), COUNTER], 'signal "crc": start 56'),
        ([CRC, COUNTER.replace("8|4", "12|4")], 'signal "counter": start 12'),
        ([CRC, COUNTER.replace("8|4", "8|8")], 'signal "counter": start 8, 8 bits'),
        ([CRC, COUNTER.replace("(1,0)", "(2,0)")], "scale 1"),
        ([CRC, COUNTER.replace("8|4", "4|4")], "overlap"),
    ],
)
def test_profile2_out_of_place(tmp_path: Path, signals: list[str], said: str) -> None:
    refused(dbc_with(tmp_path, message(*signals)), '"M"', said, protections=PROFILE2)


def test_without_protection_crc_and_counter_are_plain_signals(tmp_path: Path) -> None:
    path = dbc_with(tmp_path, message(CRC, COUNTER))
    assert [s.name for s in load_messages(path, PLAIN, ["M"])[0].signals] == ["crc", "counter"]


@pytest.mark.parametrize("length", [0, 12, 64])
def test_frames_that_are_not_classic_can(tmp_path: Path, length: int) -> None:
    refused(dbc_with(tmp_path, message(length=length)), '"M"', f"{length} data bytes", "1 to 8")


def test_extended_ids(tmp_path: Path) -> None:
    path = dbc_with(tmp_path, message('x : 0|8@1+ (1,0) [0|0] ""', frame_id=0x80000100))
    refused(path, '"M"', "extended", "0x7FF")


def test_float_signals(tmp_path: Path) -> None:
    path = dbc_with(tmp_path, message('x : 0|32@1- (1,0) [0|0] ""') + "SIG_VALTYPE_ 256 x : 1;\n")
    refused(path, '"x"', "float")


def test_more_bits_than_float64_holds(tmp_path: Path) -> None:
    refused(dbc_with(tmp_path, message('x : 0|64@1- (1,0) [0|0] ""')), '"x"', "64 bits", "1 to 53")


@pytest.mark.parametrize(
    ("scale", "limits", "expected"),
    [
        ("(1,0)", "[0|0]", (-128, 127)),  # no limits given
        ("(0.1,0)", "[-1|0.7]", (-10, 7)),
        ("(0.1,0)", "[-1|0.75]", (-10, 7)),
        ("(-0.1,0)", "[-1|0.7]", (-7, 10)),
        ("(1,100)", "[90|300]", (-10, 127)),
    ],
)
def test_limits_become_raw_integers(tmp_path: Path, scale: str, limits: str, expected: tuple[int, int]) -> None:
    path = dbc_with(tmp_path, message(f'x : 0|8@1- {scale} {limits} ""'))
    signal = load_messages(path, PLAIN, ["M"])[0].signals[0]
    assert (signal.raw_min, signal.raw_max) == expected


def test_limits_that_exclude_everything(tmp_path: Path) -> None:
    refused(dbc_with(tmp_path, message('x : 0|8@1+ (1,0) [300|400] ""')), '"x"', "300", "400")


def test_the_rig_and_the_file_agree() -> None:
    """Every signal that rigs/bench.toml names is in the file."""
    text = (BENCH_DBC.parent / "bench.toml").read_text()
    codec = load_codec(BENCH_DBC, PROTECTIONS, SENSOR_MESSAGES, [COMMAND])
    paths = re.findall(r'^\w+ = "(\w+\.\w+)"$', text.split("[signals]")[1].split("\n[")[0], flags=re.M)
    named = [re.match(r'\w+ = "([\w.]+)"', line) for line in text.split("[signals]")[1].split("\n[")[0].splitlines()]
    assert len([match for match in named if match]) == 9 >= len(paths)
    for match in named:
        if match:
            codec.slot(match[1])

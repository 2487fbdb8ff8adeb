"""What a person does wrong at the command line and in files: one clear line, no traceback, nothing moves."""

import signal
import socket
from pathlib import Path

import pytest
from bench_rig import ROOT, hil, only_folder, start, wait_until, write_rig

DBC = (ROOT / "rigs" / "bench.dbc").read_text()


def refusal(*arguments: object, mistakes: int = 1) -> str:
    """What a refused command says: one line for each of the mistakes."""
    done = hil(*arguments)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.startswith("hil: ")
    assert done.stderr.count("\n") <= mistakes, done.stderr
    return done.stderr


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        ({"stroke_m = ": "stroke_mm = "}, ["rig.toml", "cylinder.stroke_mm", "stroke_m"]),
        ({'stroke_m = "600 mm"': 'stroke_m = "210 bar"'}, ["rig.toml", "cylinder.stroke_m", "210 bar"]),
        ({"c = [120.0, 13440.0, 768000.0]": "c = [120.0, 1.0, 768000.0]"}, ["c = (120.0, 1.0", "Hurwitz"]),
        ({"amplitude_m = 0.15": "amplitude_m = 0.35"}, ["rig.toml", "reference.amplitude_m", "0.58"]),
        ({'position = "Position.position"': 'position = "Position.place"'}, ["bench.dbc", "place", "Position"]),
    ],
)
def test_a_wrong_rig_file_names_file_key_and_what_is_allowed(
    tmp_path: Path, edits: dict[str, str], words: list[str]
) -> None:
    lines = refusal("run", write_rig(tmp_path, edits), mistakes=2)
    for word in words:
        assert word in lines
    assert not (tmp_path / "runs").exists()  # refused before anything is written


@pytest.mark.parametrize(
    ("dbc", "words"),
    [
        (DBC.replace(" SG_ position ", " SG_ place "), ["bench.dbc", "position"]),
        (DBC.replace("(1e-06,0)", "(0,0)").replace("(0.000001,0)", "(0,0)"), ["bench.dbc", "position", "0"]),
        (DBC.replace("BO_ 289 ", "BO_ 288 "), ["bench.dbc", "ValveStatus", "Position", "0x120"]),
        (DBC[:40], ["bench.dbc"]),
        ("", ["bench.dbc"]),
    ],
)
def test_a_wrong_dbc_names_the_message_or_signal(tmp_path: Path, dbc: str, words: list[str]) -> None:
    assert dbc != DBC
    line = refusal("run", write_rig(tmp_path, dbc=dbc))
    for word in words:
        assert word in line


def test_no_such_rig_file() -> None:
    assert "no_such.toml" in refusal("run", "no_such.toml")


def test_a_bus_that_does_not_exist(tmp_path: Path) -> None:
    line = refusal("run", write_rig(tmp_path, {'interface = "servohil"': 'interface = "socketcan"'}))
    assert "socketcan" in line and "sudo" in line  # says which command would help


def test_an_unknown_interface(tmp_path: Path) -> None:
    line = refusal("rig", write_rig(tmp_path, {'interface = "servohil"': 'interface = "carrier-pigeon"'}))
    assert "carrier-pigeon" in line and "socketcan" in line


def test_a_zenoh_port_in_use(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        line = refusal("run", write_rig(tmp_path, {"tcp/127.0.0.1:0": endpoint}))
        assert endpoint in line and "in use" in line


def test_a_second_controller_on_the_bus(tmp_path: Path) -> None:
    rig = write_rig(tmp_path)
    first = start("run", rig)
    try:
        wait_until(lambda: recording_exists(tmp_path), "the first controller's recording")
        line = refusal("run", rig)
        assert "controller" in line and str(first.pid) in line
    finally:
        first.send_signal(signal.SIGTERM)
        output, _ = first.communicate(timeout=60)
    assert first.returncode == 0, output


def recording_exists(folder: Path) -> bool:
    run = only_folder(folder / "runs")
    return run is not None and (run / "recording.mcap").exists()


@pytest.mark.parametrize(
    "options",
    [("--leak-kind", "sideways"), ("--duration", "-1"), ("--rate", "nan"), ("--rate", "1e9"), ("--seed", "-3")],
)
def test_wrong_options_are_refused_by_name(options: tuple[str, str]) -> None:
    done = hil("bench", *options)
    assert done.returncode != 0
    assert options[0] in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("content", [b"", b"no recording at all", b"\x89MCAP0\r\n" + b"\0" * 100])
def test_replay_of_something_else(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    assert "x.mcap" in refusal("replay", path)
    assert "missing.mcap" in refusal("replay", tmp_path / "missing.mcap")


def test_a_rig_without_a_plant_has_no_bench(tmp_path: Path) -> None:
    path = write_rig(tmp_path)
    path.write_text(path.read_text().split("[plant]")[0])
    assert "plant" in refusal("bench", path)
    assert "plant" in refusal("rig", path)

"""Beyond loopback nothing starts without certificates and access control: neither the rig file nor the process."""

import json
from pathlib import Path
from typing import Any

import pytest

from servohil.hil.config import ConfigError, load_rig
from servohil.hil.config.effective import write_effective
from servohil.hil.ring import RingWriter
from servohil.hil.secure.access import People
from servohil.hil.secure.folder import make_folder
from servohil.hil.telemetry.process import Telemetry
from servohil.hil.telemetry.session import free_endpoint, hub_settings
from servohil.hil.telemetry.setup import TelemetryError, TelemetrySetup

ROOT = Path(__file__).parents[2]
BENCH = (ROOT / "rigs" / "bench.toml").read_text()
LISTEN = 'listen = "tcp/127.0.0.1:7447"'
BEYOND = "must be tcp/127.0.0.1:PORT, or tls/HOST:PORT with credentials"


def rig_file(folder: Path, *lines: str) -> Path:
    assert LISTEN in BENCH
    (folder / "bench.dbc").write_bytes((ROOT / "rigs" / "bench.dbc").read_bytes())
    path = folder / "rig.toml"
    path.write_text(BENCH.replace(LISTEN, "\n".join(lines)))
    return path


@pytest.mark.parametrize(
    "listen",
    [
        "tcp/0.0.0.0:7447",
        "tcp/192.168.1.4:7447",
        "tcp/[::]:7447",
        "udp/127.0.0.1:7447",
        "ws/0.0.0.0:80",
        "quic/rig:7447",
        "tls/rig:70000",
        "tls/rig",
        "tls/:7447",
        "tls/rig:7447#enable_mtls=false",
        "tls/rig#enable_mtls=false:7447",
        "tls/rig:7447?prio=1",
        "tls/rig:7447#enable_mtls=false:1",
        "tcp/127.0.0.1:7447\ntcp/0.0.0.0:7447",
        "tls/rig:7447\n",
    ],
)
def test_an_endpoint_for_strangers_is_refused_twice(tmp_path: Path, listen: str) -> None:
    folder = tmp_path / "doors"
    make_folder(folder, "bench", People(("anna",), ()))
    credentials = str(folder / "telemetry") if listen.startswith("tls") else None
    lines = [f"listen = {json.dumps(listen)}", *([f'credentials = "{credentials}"'] if credentials else [])]
    with pytest.raises(ConfigError) as caught:
        load_rig(rig_file(tmp_path, *lines))
    assert f"telemetry.listen = {json.dumps(listen)}: {BEYOND}" in str(caught.value)
    if listen.startswith("udp"):
        return  # stays on this machine, so the process itself has nothing against it
    with pytest.raises(TelemetryError) as refused:
        Telemetry(TelemetrySetup(ring="/nowhere", rig="bench", listen=listen, credentials=credentials))
    assert f"telemetry.listen = {listen}: {BEYOND}" in str(refused.value)


def test_tls_needs_credentials_and_the_other_way_round(tmp_path: Path) -> None:
    for lines, said in (
        (['listen = "tls/rig:7447"'], "telemetry.credentials: missing; allowed: the folder `telemetry`"),
        ([LISTEN, 'credentials = "x"'], 'telemetry.credentials = "x": means nothing without TLS'),
        (['listen = "tls/rig:7447"', 'credentials = ""'], "telemetry.credentials"),
    ):
        with pytest.raises(ConfigError) as caught:
            load_rig(rig_file(tmp_path, *lines))
        assert said in str(caught.value) and len(str(caught.value).splitlines()) == 1
    with pytest.raises(TelemetryError, match=r"telemetry\.credentials: missing"):
        Telemetry(TelemetrySetup(ring="/nowhere", rig="bench", listen="tls/127.0.0.1:0"))
    with pytest.raises(TelemetryError, match=r"telemetry\.credentials = x: means nothing"):
        Telemetry(TelemetrySetup(ring="/nowhere", rig="bench", credentials="x"))
    with pytest.raises(TelemetryError, match=r"telemetry\.connect = tcp/10\.0\.0\.1:1"):
        Telemetry(TelemetrySetup(ring="/nowhere", rig="bench", connect=("tcp/10.0.0.1:1",)))


def break_nothing(folder: Path) -> None:
    (folder / "key.pem").chmod(0o644)


def no_access(folder: Path) -> None:
    (folder / "access.json").unlink()


def open_access(folder: Path) -> None:
    (folder / "access.json").write_text('{"enabled": true, "default_permission": "allow"}')


def no_key(folder: Path) -> None:
    (folder / "key.pem").write_text("-----BEGIN PRIVATE KEY-----\nAAAA\n-----END PRIVATE KEY-----\n")


@pytest.mark.processes
@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (break_nothing, "key.pem: mode 0644"),
        (no_access, "access.json: no such file"),
        (open_access, 'default_permission = "allow": must be "deny"'),
        (no_key, "cannot listen on tls/127.0.0.1:0"),
    ],
)
def test_damaged_credentials_keep_the_process_from_starting(tmp_path: Path, damage: Any, said: str) -> None:
    make_folder(tmp_path / "doors", "bench", People(("anna",), ()))
    credentials = tmp_path / "doors" / "telemetry"
    damage(credentials)
    ring = RingWriter(directory=tmp_path)
    try:
        with pytest.raises(TelemetryError) as caught:
            Telemetry(
                TelemetrySetup(
                    ring=str(ring.file.path), rig="bench", listen="tls/127.0.0.1:0", credentials=str(credentials)
                )
            )
        assert said in str(caught.value) and "\n" not in str(caught.value)
        assert not ring.reader_alive
    finally:
        ring.close()


def test_a_rig_file_finds_its_credentials_from_anywhere(tmp_path: Path) -> None:
    secured = ['listen = "tls/rig.example:7447"', 'credentials = "doors/telemetry"']
    rig = load_rig(rig_file(tmp_path, *secured))
    assert rig.credentials_path == tmp_path / "doors" / "telemetry"
    (tmp_path / "run").mkdir()
    effective = write_effective(rig, tmp_path / "run")
    assert effective.credentials_path == rig.credentials_path
    assert effective.config_hash() == rig.config_hash(), "where files lie is no part of what runs"
    plain = load_rig(rig_file(tmp_path, LISTEN))
    assert plain.credentials_path is None and plain.config_hash() != rig.config_hash()
    assert plain.config_hash() == load_rig(ROOT / "rigs" / "bench.toml").config_hash()


def test_what_a_secured_hub_is_told(tmp_path: Path) -> None:
    make_folder(tmp_path / "doors", "bench", People(("anna",), ()))
    settings = hub_settings("tls/127.0.0.1:1", tmp_path / "doors" / "telemetry")
    link = settings["transport"]["link"]
    assert link["protocols"] == ["tls"] and link["tls"]["enable_mtls"] and link["tls"]["close_link_on_expiration"]
    assert settings["access_control"]["default_permission"] == "deny"
    assert settings["scouting"] == {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
    assert link["rx"]["max_message_size"] <= 65536 and settings["transport"]["unicast"]["max_sessions"] <= 32
    assert "tx" in link, "queues as on loopback"
    assert "access_control" not in hub_settings("tcp/127.0.0.1:1")
    assert free_endpoint("tls/127.0.0.1:0").startswith("tls/127.0.0.1:")

"""Commands, parameters and documents over Zenoh, against a controller that answers and one that hangs."""

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from telemetry_rig import ROOT, FakeRig, until

from servohil.hil.snapshot import FIELDS
from servohil.hil.telemetry.session import stays_on_this_machine

pytestmark = pytest.mark.processes

PARAMETERS = [
    {"name": "k_sigma", "unit": "1/s", "min": 1.0, "max": 50.0, "value": 20.0},
    {"name": "amplitude_m", "unit": "m", "min": 0.0, "max": 0.3, "value": 0.15},
]


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FakeRig]:
    setup = {"parameters": PARAMETERS, "meta": {"config_hash": "abc123"}, "recording": None}
    with FakeRig(tmp_path_factory.mktemp("queries"), rate_hz=500.0, setup=setup) as running:
        yield running.ready()


def state_now(rig: FakeRig) -> str:
    """The device state in a readable snapshot published from now on."""
    texts = rig.subscribe("snapshot")
    until(lambda: len(texts) >= 2, "two snapshots")
    return str(json.loads(texts[-1].payload.to_bytes())["state"])


def test_commands_are_answered_with_what_became_of_them(rig: FakeRig) -> None:
    started = time.monotonic()
    (reply,) = rig.ask("cmd/enable")
    assert time.monotonic() - started < 5.0
    assert reply["ok"] and reply["result"] == "accepted" and reply["state"] == "ACTIVE"
    (later,) = rig.ask("cmd/disable")
    assert later["ok"] and later["state"] == "DISABLED" and later["cycle"] > reply["cycle"]
    (refused,) = rig.ask("cmd/reset")
    assert not refused["ok"] and refused["result"] == "refused_state"
    (unknown,) = rig.ask("cmd/explode")
    assert not unknown["ok"] and "'explode'" in unknown["error"]
    for known in ("enable", "hold", "disable", "reset", "estop", "acknowledge"):
        assert known in unknown["error"]


def test_on_loopback_a_sender_has_the_name_that_it_states(rig: FakeRig) -> None:
    events = rig.subscribe("event/info/command")
    until(lambda: rig.ask("cmd/disable") and events, "an event")
    (stated,) = rig.ask("by/anna/cmd/hold")
    (unnamed,) = rig.ask("cmd/disable")
    (set_value,) = rig.ask("by/anna/param/k_sigma", {"value": 20.0})
    assert stated["state"] == "HOLD" and unnamed["ok"] and set_value["ok"]
    expected = [("anna", False, "hold"), ("", False, "disable"), ("anna", False, "k_sigma = 20 1/s")]

    def told() -> list[tuple[str, bool, str]]:
        found = [json.loads(event.payload.to_bytes()) for event in events]
        return [(event["sender"], event["proven"], event["command"]) for event in found]

    until(lambda: told()[-3:] == expected, "the events of the last three")
    for sender in ("a b", "x" * 33, "-", "ä"):
        (refused,) = rig.ask(f"by/{sender}/cmd/hold")
        assert refused["result"] == "refused" and "letters, digits" in refused["error"]
    assert rig.ask("by/*/cmd/hold") == [] and rig.ask("by/*/cmd/estop") == []


def test_listing_all_keys_moves_nothing(rig: FakeRig) -> None:
    rig.ask("cmd/disable")
    for pattern in (f"{ROOT}/cmd/*", f"{ROOT}/**", "servohil/**", f"{ROOT}/cmd/**", f"{ROOT}/cmd/ena$*"):
        for reply in rig.session.get(pattern, timeout=5.0):
            assert reply.ok is not None and "/cmd/" not in str(reply.ok.key_expr), pattern
    assert state_now(rig) == "DISABLED"


def test_parameters_are_read_set_and_kept_within_bounds(rig: FakeRig) -> None:
    assert rig.ask("param/k_sigma") == [PARAMETERS[0]]
    assert sorted(rig.ask("param/*"), key=lambda p: p["name"]) == sorted(PARAMETERS, key=lambda p: p["name"])
    (done,) = rig.ask("param/k_sigma", {"value": 12.5})
    assert done["ok"] and done["value"] == 12.5 and done["unit"] == "1/s" and done["cycle"] > 0
    (done,) = rig.ask("param/amplitude_m?value=0.25")
    assert done["ok"] and done["value"] == 0.25
    assert [p["value"] for p in (*rig.ask("param/k_sigma"), *rig.ask("param/amplitude_m"))] == [12.5, 0.25]
    (refused,) = rig.ask("param/k_sigma", {"value": 51})
    assert refused["result"] == "out_of_range" and refused["value"] == 12.5
    assert "k_sigma = 51 1/s" in refused["error"] and "1 to 50 1/s" in refused["error"]
    (unknown,) = rig.ask("param/k_simga", {"value": 2})
    assert not unknown["ok"] and "'k_simga'" in unknown["error"] and "k_sigma, amplitude_m" in unknown["error"]
    (pattern,) = rig.ask("param/*", {"value": 2})
    assert not pattern["ok"] and "one parameter" in pattern["error"]
    rig.ask("param/k_sigma", {"value": 20.0})
    rig.ask("param/amplitude_m", {"value": 0.15})


@pytest.mark.parametrize(
    "payload",
    [
        b"{",
        b"\xff\xfe",
        b"[1]",
        b"12",
        b'{"valeu": 3}',
        b'{"value": "fast"}',
        b'{"value": NaN}',
        b'{"value": true}',
        b'{"value": null}x',
    ],
)
def test_a_payload_that_says_no_number_changes_nothing(rig: FakeRig, payload: bytes) -> None:
    before = rig.ask("param/k_sigma")
    (reply,) = rig.ask("param/k_sigma", payload)
    assert not reply["ok"] and "expected" in reply["error"]
    assert rig.ask("param/k_sigma") == before


def test_meta_has_units_meanings_and_versions(rig: FakeRig) -> None:
    (meta,) = rig.ask("meta")
    assert list(meta["fields"]) == [name for name, _, _, _ in FIELDS]
    assert meta["fields"]["est_velocity_mps"] == {
        "unit": "m/s",
        "type": "double",
        "meaning": "estimated velocity",
        "number": 29,
    }
    assert meta["config_hash"] == "abc123" and meta["servohil"] and meta["endpoint"] == rig.endpoint
    assert meta["states"]["3"] == "ACTIVE"


def test_schema_alone_decodes_the_stream(rig: FakeRig) -> None:
    replies = {str(r.ok.key_expr): r.ok for r in rig.session.get(f"{ROOT}/schema/**", timeout=5.0) if r.ok}
    assert set(replies) == {f"{ROOT}/schema/state", f"{ROOT}/schema/servohil.proto"}
    assert "package servohil.v1;" in replies[f"{ROOT}/schema/servohil.proto"].payload.to_string()
    described = descriptor_pb2.FileDescriptorSet.FromString(replies[f"{ROOT}/schema/state"].payload.to_bytes())
    pool = descriptor_pool.DescriptorPool()
    for file in described.file:
        pool.Add(file)
    batch_class = message_factory.GetMessageClass(pool.FindMessageTypeByName("servohil.v1.StateBatch"))
    batches = rig.subscribe("state")
    until(lambda: len(batches) > 2, "batches")
    cycles = [s.cycle for b in batches[:3] for s in batch_class.FromString(b.payload.to_bytes()).samples]
    assert cycles == list(range(cycles[0], cycles[0] + len(cycles)))


def test_a_controller_that_hangs_is_a_timeout_and_an_event(tmp_path: Path) -> None:
    with FakeRig(tmp_path, rate_hz=500.0, setup={"recording": None}) as rig:
        rig.ready()
        stalls = rig.subscribe("event/warning/stalled")
        assert rig.ask("cmd/hold")[0]["ok"]
        os.kill(rig.controller.pid, signal.SIGSTOP)
        until(lambda: stalls, "the event")
        assert json.loads(stalls[0].payload.to_bytes())["active"] is True
        started = time.monotonic()
        (reply,) = rig.ask("cmd/enable")
        assert 0.4 < time.monotonic() - started < 5.0
        assert not reply["ok"] and reply["result"] == "timeout" and "0.5 s" in reply["error"]
        # A flood fills the 16 slots; the rest is refused at once instead of being queued for later.
        handler = [rig.session.get(f"{ROOT}/cmd/hold", timeout=5.0) for _ in range(30)]
        texts = [json.loads(reply.ok.payload.to_bytes())["error"] for get in handler for reply in get if reply.ok]
        assert len(texts) == 30
        assert sum("does not take commands" in text for text in texts) == 15
        os.kill(rig.controller.pid, signal.SIGCONT)
        until(lambda: len(stalls) > 1, "its end")
        assert json.loads(stalls[-1].payload.to_bytes())["active"] is False
        until(lambda: rig.ask("cmd/disable")[0]["ok"], "answers again")


def test_liveliness_of_a_killed_telemetry_ends(tmp_path: Path) -> None:
    with FakeRig(tmp_path, rate_hz=200.0, setup={"recording": None}) as rig:
        rig.ready()
        alive: list[zenoh.Sample] = []
        watch = rig.session.liveliness().declare_subscriber(f"{ROOT}/alive", alive.append, history=True)
        until(lambda: alive, "liveliness")
        os.kill(rig.telemetry_pid, signal.SIGKILL)
        until(lambda: len(alive) > 1, "its end")
        assert alive[-1].kind == zenoh.SampleKind.DELETE
        del watch


@pytest.mark.parametrize(
    "payload",
    [
        b"[" * 100_000,
        b"[" * 200,
        b'{"value": ' + b"9" * 200 + b"}",
        b'{"value": 1' + b"0" * 400 + b"}",
        b" " * 257 + b'{"value": 3}',
    ],
    ids=["deep", "less deep", "huge", "huge and long", "long"],
)
def test_a_payload_made_to_break_the_reader_is_refused(rig: FakeRig, payload: bytes) -> None:
    (reply,) = rig.ask("param/k_sigma", payload)
    assert reply["result"] == ("out_of_range" if b"999" in payload else "refused")
    assert rig.ask("param/k_sigma")[0]["value"] == 20.0


def test_what_stays_on_this_machine() -> None:
    inside = ("tcp/127.0.0.1:7447", "tcp/[::1]:7447", "unixsock-stream//run/x", "tcp/localhost:1")
    beyond = ("tcp/0.0.0.0:7447", "tcp/192.168.1.4:7447", "tcp/[::]:7447", "tls/rig.example:7447", "tcp/127.0.0.1")
    assert all(map(stays_on_this_machine, inside)) and not any(map(stays_on_this_machine, beyond))

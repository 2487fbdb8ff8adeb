"""Doors with real TLS sessions between processes on loopback: a stranger, somebody of another authority, a viewer, an
operator. The oracle is what the controller has seen: the sequence number of its last command."""

import json
import socket
import ssl
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh
from telemetry_rig import RIG, ROOT, FakeRig, until

from servohil.hil.recording.reader import Event, Recording
from servohil.hil.secure.access import People
from servohil.hil.secure.folder import make_folder
from servohil.hil.telemetry.rate_limit import COMMANDS_PER_S
from servohil.hil.telemetry.session import client_settings, open_session

pytestmark = pytest.mark.processes

PARAMETERS = [{"name": "k_sigma", "unit": "1/s", "min": 1.0, "max": 50.0, "value": 20.0}]
PEOPLE = People(operators=("anna", "bob"), viewers=("vera",))


@pytest.fixture(scope="module")
def doors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("doors")
    make_folder(folder / "ours", RIG, PEOPLE)
    make_folder(folder / "theirs", RIG, PEOPLE)
    return folder


@pytest.fixture(scope="module")
def rig(doors: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[FakeRig]:
    """A telemetry process behind certificates; its client here is anna."""
    setup = {
        "listen": "tls/127.0.0.1:0",
        "credentials": str(doors / "ours" / "telemetry"),
        "parameters": PARAMETERS,
    }
    person = doors / "ours" / "people" / "anna"
    with FakeRig(tmp_path_factory.mktemp("rig"), rate_hz=500.0, person=person, setup=setup) as running:
        yield running.ready()


def seen(rig: FakeRig) -> dict[str, Any]:
    """A snapshot of a cycle that ran after this call began."""
    texts = rig.subscribe("snapshot")
    until(lambda: len(texts) >= 2, "two snapshots")
    return dict(json.loads(texts[-1].payload.to_bytes()))


def answers(session: zenoh.Session, key: str, payload: bytes | None = None) -> list[dict[str, Any]]:
    replies = session.get(f"{ROOT}/{key}", payload=payload, timeout=3.0)
    return [json.loads(reply.ok.payload.to_bytes()) for reply in replies if reply.ok]


def try_session(endpoint: str, *, patience_ms: int = 400, **tls: Any) -> zenoh.Session | None:
    """A client session, None if the other side does not let it in."""
    settings = client_settings([endpoint])
    settings["connect"]["timeout_ms"] = patience_ms
    settings["transport"]["link"]["tls"] = tls
    try:
        return open_session(settings)
    except zenoh.ZError:
        return None


def shown(folder: Path) -> dict[str, Any]:
    """What a client shows when it connects with certificate and key of `folder`."""
    certificate, key = str(folder / "certificate.pem"), str(folder / "key.pem")
    return {"connect_certificate": certificate, "connect_private_key": key, "enable_mtls": True}


def test_without_credentials_there_is_no_session(rig: FakeRig, doors: Path) -> None:
    ours = {"root_ca_certificate": str(doors / "ours" / "telemetry" / "authority.pem")}
    assert try_session(rig.endpoint) is None
    assert try_session(rig.endpoint, **ours) is None
    assert try_session(rig.endpoint.replace("tls/", "tcp/")) is None
    theirs, own = doors / "theirs" / "people" / "anna", doors / "ours" / "people" / "anna"
    assert try_session(rig.endpoint, **ours, **shown(theirs)) is None, "a certificate of another authority"
    stolen = {**shown(theirs), "connect_certificate": str(own / "certificate.pem")}
    assert try_session(rig.endpoint, **ours, **stolen) is None, "a certificate without its key"
    server = doors / "ours" / "telemetry"
    own_server = {
        "connect_certificate": str(server / "certificate.pem"),
        "connect_private_key": str(server / "key.pem"),
    }
    assert try_session(rig.endpoint, **ours, **own_server, enable_mtls=True) is None, "a server's certificate"
    # The same door with the right key in it opens, so that the refusals above are about the key.
    let_in = try_session(rig.endpoint, patience_ms=5000, **ours, **shown(own))
    assert let_in is not None
    let_in.close()


@pytest.mark.parametrize("person", [None, "theirs", "ours"])
def test_the_handshake_as_openssl_sees_it(rig: FakeRig, doors: Path, person: str | None) -> None:
    """An independent TLS implementation: whoever shows no certificate of ours gets no byte of data."""
    context = ssl.create_default_context(cafile=doors / "ours" / "telemetry" / "authority.pem")
    if person is not None:
        own = doors / person / "people" / "vera"
        context.load_cert_chain(own / "certificate.pem", own / "key.pem")
    host, _, port = rig.endpoint.removeprefix("tls/").rpartition(":")
    with socket.create_connection((host, int(port)), timeout=5.0) as plain:
        plain.settimeout(1.0)
        if person == "ours":
            with context.wrap_socket(plain, server_hostname=host) as link:
                assert ("commonName", "telemetry") in [pair for rdn in link.getpeercert()["subject"] for pair in rdn]
                with pytest.raises(TimeoutError):
                    link.recv(1)
        else:
            # TLS 1.3: the client's end of the handshake may succeed before the server looks at the certificate.
            with pytest.raises(ssl.SSLError), context.wrap_socket(plain, server_hostname=host) as link:
                link.recv(1)


def test_a_person_cannot_pass_for_the_telemetry_process(doors: Path) -> None:
    own = doors / "ours" / "people" / "vera"
    context = ssl.create_default_context(cafile=doors / "ours" / "telemetry" / "authority.pem")
    server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    server.load_cert_chain(own / "certificate.pem", own / "key.pem")
    ours, theirs = ssl.MemoryBIO(), ssl.MemoryBIO()
    client = context.wrap_bio(ours, theirs, server_hostname="127.0.0.1")
    fake = server.wrap_bio(theirs, ours, server_side=True)
    with pytest.raises(ssl.SSLCertVerificationError):
        for _ in range(4):
            for end in (client, fake):
                try:
                    end.do_handshake()
                except ssl.SSLWantReadError:
                    continue


def test_a_viewer_reads_and_moves_nothing(rig: FakeRig, doors: Path) -> None:
    before = seen(rig)["command_seq"]
    settings = client_settings([rig.endpoint], doors / "ours" / "people" / "vera")
    with open_session(settings) as vera:
        states: list[zenoh.Sample] = []
        spoofed: list[zenoh.Sample] = []
        watch = vera.declare_subscriber(f"{ROOT}/state", states.append)
        until(lambda: len(states) > 3, "state")
        assert answers(vera, "meta")[0]["rig"] == RIG
        assert answers(vera, "param/k_sigma") == PARAMETERS
        schema = list(vera.get(f"{ROOT}/schema/state", timeout=3.0))
        assert len(schema) == 1 and schema[0].ok is not None
        for command in ("enable", "estop", "hold", "disable", "reset", "acknowledge"):
            for key in (f"cmd/{command}", f"by/anna/cmd/{command}", f"by/vera/cmd/{command}", f"by/*/cmd/{command}"):
                assert answers(vera, key) == [], key
        assert answers(vera, "cmd/*") == answers(vera, "**") == []
        assert answers(vera, "by/anna/param/k_sigma", b'{"value": 12}') == []
        for key in ("param/k_sigma", "param/k_sigma?value=12"):
            (refused,) = answers(vera, key, None if "?" in key else b'{"value": 12}')
            assert refused["result"] == "refused" and f"{ROOT}/by/" in refused["error"]
        watch_operator = rig.session.declare_subscriber(f"{ROOT}/**", spoofed.append)
        for key in ("cmd/enable", "by/anna/cmd/enable", "by/vera/cmd/enable", "param/k_sigma", "state", "spoof"):
            vera.put(f"{ROOT}/{key}", b'{"value": 12}')
        # Nor can a viewer answer in the name of the controller.
        liar = vera.declare_queryable(f"{ROOT}/by/anna/cmd/lie", lambda query: query.reply(query.key_expr, b"{}"))
        assert answers(vera, "meta")  # one session keeps its order: what was declared and put before this has arrived
        (honest,) = rig.ask("by/anna/cmd/lie")
        assert "unknown command" in honest["error"]
        del watch, watch_operator, liar
    assert not [sample for sample in spoofed if sample.payload.to_bytes() == b'{"value": 12}']
    assert rig.ask("param/k_sigma") == PARAMETERS
    after = seen(rig)
    assert (after["command_seq"], after["state"]) == (before, "DISABLED")


def test_an_operator_commands_under_the_own_name_only(rig: FakeRig) -> None:
    events = rig.subscribe("event/info/command")
    before = seen(rig)["command_seq"]
    (reply,) = rig.ask("by/anna/cmd/enable")
    assert reply["ok"] and reply["state"] == "ACTIVE"
    (changed,) = rig.ask("by/anna/param/k_sigma", {"value": 12.5})
    assert changed["ok"] and changed["value"] == 12.5
    (outside,) = rig.ask("by/anna/param/k_sigma", {"value": 51})
    assert outside["result"] == "out_of_range" and "1 to 50 1/s" in outside["error"]
    (stopped,) = rig.ask("by/anna/cmd/estop")
    assert stopped["ok"] and stopped["state"] == "FAULT_DISABLED"
    for key in ("by/bob/cmd/disable", "by/vera/cmd/disable", "by/*/cmd/disable"):
        assert rig.ask(key) == [], key
    (refused,) = rig.ask("cmd/disable")
    assert not refused["ok"] and f"{ROOT}/by/" in refused["error"]
    assert rig.ask("by/anna/cmd/disable")[0]["ok"] and rig.ask("by/anna/param/k_sigma", {"value": 20})[0]["ok"]
    assert seen(rig)["command_seq"] == before + 5
    until(lambda: len(events) >= 6, "events")
    told = [json.loads(event.payload.to_bytes()) for event in events]
    assert all(event["sender"] == "anna" and event["proven"] for event in told)
    assert [(event["command"], event["result"]) for event in told] == [
        ("enable", "accepted"), ("k_sigma = 12.5 1/s", "accepted"), ("k_sigma = 51 1/s", "out_of_range"),
        ("estop", "accepted"), ("disable", "accepted"), ("k_sigma = 20 1/s", "accepted"),
    ]  # fmt: skip


def test_who_commanded_stands_in_the_recording(rig: FakeRig) -> None:
    assert rig.ask("by/anna/cmd/hold")[0]["ok"]

    def recorded() -> list[tuple[Any, ...]]:
        events = [item.content for item in Recording(rig.recording).items() if isinstance(item, Event)]
        return [(e["sender"], e["proven"], e["command"]) for e in events if e["code"] == "command"]

    until(lambda: ("anna", True, "hold") in recorded(), "the event in the recording")


def test_a_flood_is_cut_and_the_estop_is_not(rig: FakeRig, doors: Path) -> None:
    warnings = rig.subscribe("event/warning/command_rate")
    with open_session(client_settings([rig.endpoint], doors / "ours" / "people" / "bob")) as bob:
        results: list[dict[str, Any]] = []
        started = time.monotonic()

        def limited() -> list[dict[str, Any]]:
            gets = [bob.get(f"{ROOT}/by/bob/cmd/hold", timeout=3.0) for _ in range(10)]
            burst = [json.loads(r.ok.payload.to_bytes()) for get in gets for r in get if r.ok]
            results.extend(burst)
            return [r for r in burst if r["result"] == "rate_limited"]

        refused = until(limited, "the limit")  # in bursts: a full channel drops the oldest
        seconds = int(time.monotonic() - started) + 1  # each begun one has an allowance of its own
        accepted = [r["result"] for r in results].count("accepted")
        assert COMMANDS_PER_S <= accepted <= COMMANDS_PER_S * (seconds + 1)
        assert f"allowed: {COMMANDS_PER_S} per second" in refused[0]["error"]
        assert answers(bob, "by/bob/cmd/estop")[0]["ok"]
        (other,) = rig.ask("by/anna/cmd/disable")
        assert other["ok"], "the limit is per sender"
        until(lambda: warnings, "the event")
        assert json.loads(warnings[0].payload.to_bytes())["sender"] == "bob"
        until(limited, "the limit once more, should that second be over")
        (too_many,) = answers(bob, "by/bob/param/k_sigma", b'{"value": 7}')
        assert too_many["result"] == "rate_limited" and rig.ask("param/k_sigma") == PARAMETERS
        until(lambda: answers(bob, "by/bob/cmd/disable")[0]["ok"], "the next second")

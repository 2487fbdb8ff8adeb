"""The way to a rig over real sessions: documents, commands, a restart of the rig, and certificates."""

import json
import socket
import time
from pathlib import Path

import pytest
from telemetry_rig import RIG, FakeRig, until

from servohil.hil.secure.access import People
from servohil.hil.secure.certificates import client_certificate, common_name, new_authority
from servohil.hil.secure.folder import make_folder
from servohil.hil.view.feed import Feed
from servohil.hil.view.rig_link import RigLink

pytestmark = pytest.mark.processes

KEYS = ("state", "health", "event/**")
PARAMETERS = [{"name": "reference.offset_m", "unit": "m", "min": 0.0, "max": 1.0, "value": 0.5}]


class Watch:
    """What a page would know: a link and a feed that is ticked whenever somebody asks."""

    def __init__(self, link: RigLink) -> None:
        self.link, self.feed = link, Feed()

    def fresh(self) -> bool:
        now_ns = time.monotonic_ns()
        self.feed.tick(self.link.take(), now_ns)
        return not self.feed.freshness.is_stale(now_ns)

    def came_back(self) -> bool:
        self.fresh()
        return self.feed.documents_old

    def told(self, name: str) -> object:
        self.fresh()
        return json.loads(self.feed.greeting(time.monotonic_ns())[0]).get(name)


def test_a_link_comes_before_its_rig_commands_it_and_survives_its_restart(tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    setup = {"listen": endpoint, "parameters": PARAMETERS, "recording": None}
    link = RigLink(endpoint, RIG, KEYS)
    watch = Watch(link)
    assert link.ask("cmd/enable")["result"] == "no_connection"
    link.start()
    try:
        (tmp_path / "first").mkdir()
        with FakeRig(tmp_path / "first", setup=setup) as rig:
            rig.ready()
            until(watch.fresh, "cycles")
            until(lambda: watch.told("parameters"), "parameters, asked for without being told to")
            reply = link.ask("cmd/enable")
            assert reply["ok"] and reply["state"] == "ACTIVE"
            assert link.ask("param/reference.offset_m", {"value": 0.25})["ok"]
            refused = link.ask("param/reference.offset_m", {"value": 2.0})
            assert not refused["ok"] and "allowed is 0 to 1 m" in refused["error"]
            link.want_documents()
            until(lambda: watch.told("parameters")[0]["value"] == 0.25, "the new value")  # type: ignore[index]
            until(lambda: "view (as stated): enable: accepted" in json.dumps(watch.told("events")), "who commanded")
            rig.controller.kill()
            until(lambda: not watch.fresh(), "stale data")
        watch.feed.documents_old = False
        (tmp_path / "second").mkdir()
        with FakeRig(tmp_path / "second", setup=setup) as rig:
            rig.ready()
            until(watch.came_back, "the new run")
            until(watch.fresh, "its cycles")
    finally:
        link.close()


def test_a_person_with_a_certificate_commands_under_the_own_name(tmp_path: Path) -> None:
    make_folder(tmp_path / "doors", RIG, People(operators=("anna",), viewers=("vera",)))
    setup = {"listen": "tls/127.0.0.1:0", "credentials": str(tmp_path / "doors" / "telemetry"), "recording": None}
    people = tmp_path / "doors" / "people"
    with FakeRig(tmp_path, person=people / "anna", setup=setup) as rig:
        rig.ready()
        links = {name: RigLink(rig.endpoint, RIG, KEYS, people / name) for name in ("anna", "vera")}
        try:
            for link in links.values():
                link.start()
                until(Watch(link).fresh, "cycles behind certificates")
            assert links["anna"].ask("cmd/enable")["ok"]
            assert links["vera"].ask("cmd/estop")["result"] == "no_reply"
        finally:
            for link in links.values():
                link.close()


def test_a_certificate_says_whose_it_is() -> None:
    assert common_name(client_certificate(new_authority("bench"), "anna").certificate) == "anna"
    with pytest.raises(ValueError, match=r"."):
        common_name(b"no certificate")

"""What `hil secure` makes: modes, certificates as OpenSSL reads them, access control, refusals."""

import itertools
import json
import os
import shutil
import ssl
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from servohil.hil.cli import main
from servohil.hil.secure.access import AccessError, People, access_control, read_access
from servohil.hil.secure.credentials import CredentialsError, client_security, server_security
from servohil.hil.secure.doctor import credential_check
from servohil.hil.secure.folder import SecureFolderError, add_people, make_folder, remove_person

PEOPLE = People(("anna", "bob"), ("vera",))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("secure") / "doors"
    before = os.umask(0)  # the most careless setting there is
    try:
        make_folder(folder, "bench", PEOPLE, ("rig.example", "192.168.1.4", "fd00::4"))
    finally:
        os.umask(before)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "doors"))


def text_of(certificate: Path) -> dict[str, Any]:
    """A certificate as Python's OpenSSL binding decodes it."""
    return dict(ssl._ssl._test_decode_cert(str(certificate)))  # type: ignore[attr-defined]


def openssl(*words: str | Path) -> str:
    done = subprocess.run(["openssl", *map(str, words)], capture_output=True, text=True, check=False)
    return done.stdout + done.stderr


def test_keys_and_folders_are_private_from_the_start(made: Path) -> None:
    folders = [made, *(path for path in made.rglob("*") if path.is_dir())]
    assert len(folders) == 1 + 3 + 3
    assert {path.stat().st_mode & 0o777 for path in folders} == {0o700}
    keys = list(made.rglob("key.pem"))
    assert len(keys) == 5 and {path.stat().st_mode & 0o777 for path in keys} == {0o600}
    for path in made.rglob("*"):
        if path.is_file() and path not in keys:
            assert "PRIVATE" not in path.read_text(), path


def test_certificates_say_who_and_what_for(made: Path) -> None:
    telemetry = text_of(made / "telemetry" / "certificate.pem")
    assert telemetry["subject"] == ((("commonName", "telemetry"),),)
    assert set(telemetry["subjectAltName"]) == {
        ("IP Address", "127.0.0.1"), ("DNS", "localhost"), ("DNS", "rig.example"), ("IP Address", "192.168.1.4"),
        ("IP Address", "FD00:0:0:0:0:0:0:4"),
    }  # fmt: skip
    for name in (*PEOPLE.operators, *PEOPLE.viewers):
        own = made / "people" / name
        assert text_of(own / "certificate.pem")["subject"] == ((("commonName", name),),)
        assert (own / "authority.pem").read_bytes() == (made / "authority" / "certificate.pem").read_bytes()
        context = ssl.create_default_context(cafile=own / "authority.pem")
        context.load_cert_chain(own / "certificate.pem", own / "key.pem")  # raises where key and certificate differ
    serials = [text_of(path)["serialNumber"] for path in made.rglob("certificate.pem")]
    assert len(set(serials)) == 5


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl command on this machine")
def test_openssl_verifies_each_for_its_purpose_and_no_other(made: Path, tmp_path: Path) -> None:
    make_folder(tmp_path / "other", "bench", PEOPLE)
    authority = made / "authority" / "certificate.pem"
    for owner, purpose in itertools.product(("telemetry", "people/anna", "people/vera"), ("sslserver", "sslclient")):
        certificate = made / owner / "certificate.pem"
        said = openssl("verify", "-x509_strict", "-purpose", purpose, "-CAfile", authority, certificate)
        assert said.endswith(": OK\n") == ((owner == "telemetry") == (purpose == "sslserver")), said
    foreign = tmp_path / "other" / "people" / "anna" / "certificate.pem"
    assert "verification failed" in openssl("verify", "-CAfile", authority, foreign)
    # A person is no authority: what a person's key signs is not believed.
    chain = openssl("verify", "-CAfile", authority, "-untrusted", made / "people/anna/certificate.pem", foreign)
    assert "verification failed" in chain
    told = openssl("x509", "-in", authority, "-noout", "-text")
    assert "CA:TRUE, pathlen:0" in told and "Certificate Sign, CRL Sign" in told
    assert "CA:FALSE" in openssl("x509", "-in", made / "people/anna/certificate.pem", "-noout", "-text")


def test_only_operators_may_ask_below_their_own_name() -> None:
    access = access_control("bench", PEOPLE)
    rules = {rule["id"]: rule for rule in access["rules"]}
    reach: dict[str, set[str]] = {name: set() for name in (*PEOPLE.operators, *PEOPLE.viewers)}
    for policy in access["policies"]:
        for subject, rule in itertools.product(policy["subjects"], policy["rules"]):
            if "query" in rules[rule]["messages"]:
                reach[subject] |= set(rules[rule]["key_exprs"])
    root = "servohil/v1/bench/"
    read = {root + key for key in ("meta", "schema/**", "event/**", "param/**")}
    assert reach["vera"] == read
    for name in PEOPLE.operators:
        own = {f"{root}by/{name}/cmd/**", f"{root}by/{name}/param/**", f"{root}cmd/**"}
        assert reach[name] == read | own
    assert access["default_permission"] == "deny" and access["enabled"] is True
    into = {message for rule in rules.values() if "ingress" in rule["flows"] for message in rule["messages"]}
    assert not into & {"put", "delete", "declare_queryable", "reply", "liveliness_token"}


@pytest.mark.parametrize(
    ("people", "rig", "hosts", "said"),
    [
        (People((), ()), "bench", (), "at least one --operator or --viewer"),
        (People(("a b",), ()), "bench", (), "name 'a b': allowed: 1 to 32"),
        (People(("../x",), ()), "bench", (), "'../x'"),
        (People(("",), ()), "bench", (), "name ''"),
        (People(("*",), ()), "bench", (), "name '*'"),
        (People(("x" * 33,), ()), "bench", (), "1 to 32"),
        (People(("anna\n",), ()), "bench", (), "allowed"),
        (People(("Ánna",), ()), "bench", (), "allowed"),
        (People(("anna",), ("anna",)), "bench", (), "name 'anna' is given 2 times; allowed: once"),
        (People(("anna",), ()), "be/nch", (), "rig 'be/nch'"),
        (People(("anna",), ()), "bench", ("rig example",), "host 'rig example'"),
    ],
)
def test_what_cannot_be_made_makes_nothing(
    tmp_path: Path, people: People, rig: str, hosts: tuple[str, ...], said: str
) -> None:
    with pytest.raises(SecureFolderError, match="allowed") as caught:
        make_folder(tmp_path / "doors", rig, people, hosts)
    assert said in str(caught.value) and not (tmp_path / "doors").exists()


def test_nothing_is_overwritten(folder: Path) -> None:
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    with pytest.raises(SecureFolderError, match="exists; allowed: a new folder"):
        make_folder(folder, "bench", PEOPLE)
    for people in (People(("anna",), ()), People((), ("vera",))):
        with pytest.raises(SecureFolderError, match="already"):
            add_people(folder, people)
    assert before == {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_people_come_and_go_and_a_name_never_comes_back(folder: Path) -> None:
    def let_in() -> set[str]:
        access = read_access(folder / "telemetry" / "access.json")
        return {name for subject in access["subjects"] for name in subject["cert_common_names"]}

    add_people(folder, People((), ("walt",)))
    assert let_in() == {"anna", "bob", "vera", "walt"}
    assert (folder / "people/walt/key.pem").stat().st_mode & 0o777 == 0o600
    context = ssl.create_default_context(cafile=folder / "authority" / "certificate.pem")
    context.load_cert_chain(folder / "people/walt/certificate.pem", folder / "people/walt/key.pem")
    remove_person(folder, "anna")
    assert let_in() == {"bob", "vera", "walt"}
    assert "anna" not in (folder / "telemetry" / "access.json").read_text()
    shutil.rmtree(folder / "people" / "anna")
    with pytest.raises(SecureFolderError, match="anna was removed"):
        add_people(folder, People((), ("anna",)))
    with pytest.raises(SecureFolderError, match="nemo is not in"):
        remove_person(folder, "nemo")
    for name in ("bob", "vera"):
        remove_person(folder, name)
    with pytest.raises(SecureFolderError, match="walt is the last one"):
        remove_person(folder, "walt")
    with pytest.raises(SecureFolderError, match="no such file"):
        remove_person(folder.parent, "walt")


OPEN_DOORS = [
    ("enabled", False), ("enabled", None), ("default_permission", "allow"), ("subjects", []), ("subjects", "anna"),
    ("subjects", [{"id": "anybody"}]), ("subjects", [{"id": "x", "cert_common_names": []}]), ("subjects", ["anna"]),
    ("subjects", [{"id": "x", "interfaces": ["lo"]}]),
]  # fmt: skip


@pytest.mark.parametrize(("key", "value"), OPEN_DOORS)
def test_an_access_control_that_is_open_is_refused(folder: Path, key: str, value: object) -> None:
    path = folder / "telemetry" / "access.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))
    with pytest.raises(AccessError, match="must"):
        read_access(path)
    with pytest.raises(CredentialsError, match=r"access\.json"):
        server_security(folder / "telemetry")


@pytest.mark.parametrize("text", ["", "[", "[]", "3", "[" * 100_000, "\udcff"])
def test_what_is_no_access_control_is_refused(folder: Path, text: str) -> None:
    (folder / "telemetry" / "access.json").write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(CredentialsError, match=r"access\.json"):
        server_security(folder / "telemetry")


def test_credentials_that_cannot_be_used_name_the_file(folder: Path) -> None:
    server, person = folder / "telemetry", folder / "people" / "anna"
    assert server_security(server)["tls"]["enable_mtls"] is True
    assert client_security(person)["verify_name_on_connect"] is True
    for mode, good in ((0o640, True), (0o604, False), (0o602, False), (0o777, False)):
        for own, read in ((server, server_security), (person, client_security)):
            (own / "key.pem").chmod(mode)
            if good:
                read(own)
            else:
                with pytest.raises(CredentialsError, match=rf"key\.pem: mode 0{mode:o}, others"):
                    read(own)
    (server / "key.pem").chmod(0o600)
    for name in ("key.pem", "certificate.pem", "authority.pem", "access.json"):
        (server / name).rename(server / "away")
        with pytest.raises(CredentialsError, match=f"{name}: no such file"):
            server_security(server)
        (server / "away").rename(server / name)
    with pytest.raises(CredentialsError, match="no such folder"):
        server_security(folder / "nowhere")


def test_the_doctor_sees_the_end_coming(folder: Path) -> None:
    server = folder / "telemetry"
    end = datetime.strptime(text_of(server / "certificate.pem")["notAfter"], "%b %d %H:%M:%S %Y GMT").replace(
        tzinfo=UTC
    )
    assert timedelta(days=824) < end - datetime.now(UTC) <= timedelta(days=825)
    for before, status in ((timedelta(days=31), "ok"), (timedelta(days=29), "warn"), (timedelta(days=-1), "fail")):
        check = credential_check(server, end - before)
        assert check.status == status and f"{end:%Y-%m-%d}" in check.reason and bool(check.fix) == (status != "ok")
    (server / "key.pem").chmod(0o644)
    check = credential_check(server)
    assert check.status == "fail" and "others can read the key" in check.reason and "chmod 600" in check.fix
    (server / "key.pem").chmod(0o600)
    (server / "certificate.pem").write_text("not a certificate")
    assert credential_check(server).status == "fail"
    assert credential_check(folder / "nowhere").status == "fail"


def test_the_commands_say_what_goes_where(tmp_path: Path) -> None:
    run = CliRunner()
    folder = tmp_path / "doors"
    words = ["secure", "init", str(folder), "--operator", "anna", "--viewer", "vera", "--host", "rig.example"]
    done = run.invoke(main, words)
    assert done.exit_code == 0, done.output
    for said in ("authority", 'listen = "tls/rig.example:7447"', f'credentials = "{folder}/telemetry"', "people/vera"):
        assert said in done.output
    again = run.invoke(main, words)
    assert again.exit_code == 1 and "exists" in again.output and "Traceback" not in again.output
    added = run.invoke(main, ["secure", "add", str(folder), "--viewer", "walt"])
    assert added.exit_code == 0 and "people/walt" in added.output
    removed = run.invoke(main, ["secure", "remove", str(folder), "anna"])
    assert removed.exit_code == 0 and "anna may neither read nor command" in removed.output
    issued = json.loads((folder / "issued.json").read_text())
    assert issued == {
        "rig": "*", "hosts": ["rig.example"], "operators": [], "viewers": ["vera", "walt"], "removed": ["anna"]
    }  # fmt: skip
    assert json.loads((folder / "people/vera/zenoh.json").read_text())["connect"]["endpoints"] == [
        "tls/rig.example:7447"
    ]

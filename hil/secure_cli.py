"""`hil secure ...`: who may read and who may command over the network."""

from pathlib import Path

import click

from servohil.hil.command_line import load, one_clear_line

FOLDER = click.argument("folder", type=click.Path(path_type=Path))
OPERATOR = click.option("--operator", "operators", multiple=True, metavar="NAME", help="May read and command.")
VIEWER = click.option("--viewer", "viewers", multiple=True, metavar="NAME", help="May read.")
RESTART = "Takes effect when the controller is started next."


@click.group()
def secure() -> None:
    """Certificates and access control, for telemetry that other machines reach."""


@secure.command("init")
@FOLDER
@click.option("--rig", type=click.Path(path_type=Path), help="Rig file that this is for (default: every rig).")
@OPERATOR
@VIEWER
@click.option("--host", "hosts", multiple=True, help="Name or address by which others reach the rig PC.")
def init(
    folder: Path, rig: Path | None, operators: tuple[str, ...], viewers: tuple[str, ...], hosts: tuple[str, ...]
) -> None:
    """Make FOLDER: a certificate authority, the telemetry process's credentials, and those of people."""
    with one_clear_line():
        from servohil.hil.secure.access import People
        from servohil.hil.secure.certificates import AUTHORITY_DAYS, CERTIFICATE_DAYS
        from servohil.hil.secure.folder import PORT, make_folder

        people = People(operators, viewers)
        make_folder(folder, load(rig).name if rig else "*", people, hosts)
        _say(f"{folder}/authority", f"signs certificates, {AUTHORITY_DAYS} days; keep it off the rig PC")
        _say(f"{folder}/telemetry", f"for the rig PC, {CERTIFICATE_DAYS} days; in the rig file:")
        host = hosts[0] if hosts else "127.0.0.1"
        click.echo("\n    [telemetry]")
        click.echo(f'    listen = "tls/{f"[{host}]" if ":" in host else host}:{PORT}"')
        click.echo(f'    credentials = "{folder.absolute() / "telemetry"}"\n')
        _say_people(folder, people)


@secure.command("add")
@FOLDER
@OPERATOR
@VIEWER
def add(folder: Path, operators: tuple[str, ...], viewers: tuple[str, ...]) -> None:
    """Let more people in; FOLDER must have its authority."""
    with one_clear_line():
        from servohil.hil.secure.access import People
        from servohil.hil.secure.folder import add_people

        people = People(operators, viewers)
        add_people(folder, people)
        _say_people(folder, people)
        click.echo(RESTART)


@secure.command("remove")
@FOLDER
@click.argument("name")
def remove(folder: Path, name: str) -> None:
    """Take every right from NAME, for good."""
    with one_clear_line():
        from servohil.hil.secure.folder import remove_person

        remove_person(folder, name)
        click.echo(f"{name} may neither read nor command. {RESTART}")


def _say(path: str, what: str) -> None:
    click.echo(f"{path}: {what}")


def _say_people(folder: Path, people: tuple[tuple[str, ...], tuple[str, ...]]) -> None:
    for names, may in zip(people, ("may read and command", "may read"), strict=True):
        for name in names:
            _say(f"{folder}/people/{name}", f"for {name}, who {may}; hand it over and delete it here")

"""`hil view` and `hil top`: look at a running rig."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from servohil.hil.command_line import DEFAULT_RIG, one_clear_line


def target_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Which rig, and where its telemetry listens."""
    for option in (
        click.option("--credentials", type=click.Path(path_type=Path), help="Folder of a person, for a tls/ endpoint."),
        click.option("--rig", "name", help="Name of the rig in the Zenoh keys (default: as in RIG)."),
        click.option("--connect", metavar="ENDPOINT", help="Where telemetry listens (default: as in RIG)."),
        click.argument("rig", type=click.Path(path_type=Path), default=DEFAULT_RIG, required=False),
    ):
        command = option(command)
    return command


def target(rig: Path, connect: str | None, name: str | None, credentials: Path | None) -> tuple[str, str]:
    """(endpoint, rig name) from the rig file, unless both are given. Raises ConfigError, ValueError."""
    if connect is None or name is None:
        from servohil.hil.config import load_rig

        loaded = load_rig(rig)
        connect, name = connect or loaded.telemetry.listen, name or loaded.name
    if connect.endswith(":0"):
        raise ValueError(f"{connect}: the controller takes any free port; allowed: --connect with the one it prints")
    if connect.startswith("tls/") and credentials is None:
        raise ValueError(f"{connect}: --credentials is missing; allowed: a person's folder that `hil secure init` made")
    return connect, name


@click.command()
@target_options
@click.option("--listen", default="127.0.0.1:8090", show_default=True, help="Address and port of the page.")
@click.option("--operator", is_flag=True, help="Who opens the printed address may command: enable, hold, e-stop ...")
def view(
    rig: Path, connect: str | None, name: str | None, credentials: Path | None, listen: str, operator: bool
) -> None:
    """Serve the live page of a running rig."""
    with one_clear_line():
        from servohil.hil.view.command import view_command

        endpoint, rig_name = target(rig, connect, name, credentials)
        view_command(endpoint, rig_name, credentials, listen, operator, click.echo)


@click.command()
@target_options
@click.option("--once", is_flag=True, help="Print one screen and end; exit code 1 where nothing is heard.")
def top(rig: Path, connect: str | None, name: str | None, credentials: Path | None, once: bool) -> None:
    """Show a running rig in the terminal."""
    with one_clear_line():
        from servohil.hil.view.top import top_command

        endpoint, rig_name = target(rig, connect, name, credentials)
        top_command(endpoint, rig_name, credentials, once)

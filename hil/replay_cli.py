"""`hil replay`: a recording, or a log of a real bus, through the controller again."""

import sys
from pathlib import Path

import click

from servohil.hil.command_line import DEFAULT_RIG, EXIT_REFUSED, load, new_folder, one_clear_line, refuse_given


@click.command()
@click.argument("recording", type=click.Path(path_type=Path), required=False)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="What if this key of the rig were so?")
@click.option("--filter", "filter_name", metavar="NAME", help="The same as --set estimator.filter=NAME.")
@click.option("--figure", type=click.Path(path_type=Path), help="Draw there (.png, .svg, .pdf) what differs.")
@click.option("--realtime", is_flag=True, help="Send the recorded frames at their recorded times.")
@click.option("--interface", default="servohil", show_default=True, help="Bus of --realtime.")
@click.option("--channel", default="vcan0", show_default=True, help="Channel of --realtime.")
@click.option("--yes-a-real-bus", is_flag=True, help="Let --realtime send where real nodes may listen.")
@click.option("--can", "can_log", type=click.Path(path_type=Path), help="A CAN log instead (.log, .asc, .blf).")
@click.option("--rig", type=click.Path(path_type=Path), default=DEFAULT_RIG, help="Rig file of --can.")
@click.option("--dbc", type=click.Path(path_type=Path), help="DBC of --can instead of the rig's.")
def replay(
    recording: Path | None,
    settings: tuple[str, ...],
    filter_name: str | None,
    figure: Path | None,
    realtime: bool,
    interface: str,
    channel: str,
    yes_a_real_bus: bool,
    can_log: Path | None,
    rig: Path,
    dbc: Path | None,
) -> None:
    """Feed RECORDING through the controller again; every recorded output must come out bit for bit.

    With --set: what would it have concluded with other settings? With --realtime: put its frames on a bus. With --can:
    let the controller watch a log of somebody else's bus, in shadow mode.
    """
    if (recording is None) == (can_log is None):
        raise click.UsageError("give a RECORDING, or --can LOG")
    if filter_name is not None:
        settings = (*settings, f"estimator.filter={filter_name}")
    if not realtime:
        refuse_given(("interface", "channel", "yes_a_real_bus"), "means something with --realtime only")
    elif settings or can_log:
        raise click.UsageError("--realtime sends what was recorded: without --set, --filter and --can")
    if can_log is None:
        refuse_given(("rig", "dbc"), "means something with --can only; a recording carries its own")
    if figure is not None and not settings:
        raise click.UsageError("--figure: draws what --set or --filter change")
    code = 0
    with one_clear_line():
        if recording is None:
            assert can_log is not None
            from servohil.hil.replay_can import replay_can

            loaded = load(rig)
            directory = loaded.recording.directory
            replay_can(can_log, loaded, dbc, settings, lambda: new_folder(directory, "can"), click.echo)
        elif realtime:
            from servohil.hil.replay_bus import replay_to_bus

            replay_to_bus(recording, interface, channel, yes_a_real_bus, click.echo)
        elif settings:
            _what_if(recording, settings, figure)
        else:
            from servohil.hil.compile_message import say_when_compiling
            from servohil.hil.replay_recording import replay_recording

            say_when_compiling()
            code = 0 if replay_recording(recording, click.echo).identical else EXIT_REFUSED
    sys.exit(code)


def _what_if(recording: Path, settings: tuple[str, ...], figure: Path | None) -> None:
    from servohil.hil.compile_message import say_when_compiling
    from servohil.hil.recorded_rig import parse_settings
    from servohil.hil.what_if import what_if
    from servohil.hil.what_if_report import check_figure, draw_what_if, what_if_lines

    changes = parse_settings(settings)
    figure = figure or recording.with_name("what-if.png")
    check_figure(figure)
    say_when_compiling()
    result = what_if(recording, changes, click.echo)
    click.echo("\n".join(what_if_lines(result, changes)))
    draw_what_if(result, changes, figure)
    click.echo(f"figure       {figure}")

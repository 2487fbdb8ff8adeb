"""`hil log ...`: what is in a recording, a finished file from a broken one, and the same for other people's tools."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from servohil.hil.command_line import EXIT_REFUSED, one_clear_line

if TYPE_CHECKING:
    from servohil.hil.recording.columns import Reading

FILE = click.argument("file", type=click.Path(path_type=Path))
KINDS = {"csv": ".csv", "parquet": ".parquet", "mf4": ".mf4", "blf": ".blf", "asc": ".asc", "candump": ".log"}


@click.group()
def log() -> None:
    """Look into recordings, repair them, and export them for other tools."""


@log.command("info")
@FILE
def info_command(file: Path) -> None:
    """Say what FILE holds, where it comes from, and whether it is whole; exit code 1 if it is not."""
    with one_clear_line():
        from servohil.hil.recording.info_text import info_lines
        from servohil.hil.recording.reader import series
        from servohil.hil.recording.tools import info

        found = [info(path) for path in series(file)]
        click.echo("\n".join(info_lines(found)))
    sys.exit(0 if all(part.complete for part in found) else EXIT_REFUSED)


@log.command("repair")
@FILE
@click.option("--output", type=click.Path(path_type=Path), help="Default: NAME-repaired.mcap beside FILE.")
def repair_command(file: Path, output: Path | None) -> None:
    """Write everything readable of FILE to a new, finished file with an index; FILE stays as it is."""
    with one_clear_line():
        from servohil.hil.recording.info_text import info_lines
        from servohil.hil.recording.tools import repair

        output = output or file.with_name(f"{file.stem}-repaired{file.suffix}")
        click.echo("\n".join(info_lines([repair(file, output)])))


@log.command("export")
@FILE
@click.option("--to", "kind", type=click.Choice(list(KINDS)), required=True)
@click.option("--output", type=click.Path(path_type=Path), help="Default: the name of FILE with another ending.")
@click.option("--commands", is_flag=True, help="blf, asc, candump: rebuild the frames sent as well, by a replay.")
@click.option("--mdf-python", type=click.Path(path_type=Path), help="mf4: a Python that has asammdf.")
def export_command(file: Path, kind: str, output: Path | None, commands: bool, mdf_python: Path | None) -> None:
    """Write the signals of FILE and its continuation files as csv, parquet or mf4, or its bus traffic as blf, asc or
    candump log.
    """
    on_bus = kind in ("blf", "asc", "candump")
    if commands and not on_bus:
        raise click.UsageError(f"--commands: {kind} has every command as a signal")
    if mdf_python is not None and kind != "mf4":
        raise click.UsageError(f"--mdf-python: {kind} needs none")
    output = output or file.with_suffix(KINDS[kind])
    with one_clear_line():
        from servohil.hil.recording.columns import Reading

        reading = Reading(file)
        try:
            with progress_bar(f"export {output.name}", reading):
                text = export_can(reading, kind, output, commands) if on_bus else None
                if text is None:
                    export_table(reading, kind, output, mdf_python)
                    text = f"{reading.cycles} cycles, every signal"
        except FileExistsError:
            raise OSError(f"{output} exists: an export overwrites nothing; give another --output") from None
        for remark in reading.remarks:
            click.echo(remark)
        if reading.lost:
            click.echo(f"{reading.lost} cycles are missing in the recording: telemetry could not keep up with them")
        click.echo(f"{output}: {text}")


def export_table(reading: "Reading", kind: str, output: Path, mdf_python: Path | None) -> None:
    """Signals."""
    from servohil.hil.recording import export_mdf, export_table

    if kind == "csv":
        export_table.write_csv(reading.blocks(), output)
    elif kind == "parquet":
        export_table.write_parquet(reading.blocks(), output, reading.first.metadata)
    else:
        python = mdf_python or export_mdf.MDF_PYTHON
        export_mdf.check_mdf_python(python)
        facts = "\n".join(f"{name}: {value}" for name, value in sorted(reading.first.metadata.items()))
        export_mdf.write_mf4(reading.blocks(), output, python, facts)


def export_can(reading: "Reading", kind: str, output: Path, commands: bool) -> str:
    """Frames; what was written, in words."""
    from servohil.hil.recording.export_can import write_can

    if not commands:
        n = write_can(reading.blocks(), output, kind)
        return f"{n} frames received; --commands rebuilds those that were sent"
    from servohil.hil.recorded_commands import RecordedCommands

    rebuilt = RecordedCommands(reading.first)
    n = write_can(reading.blocks(), output, kind, rebuilt.frame)
    missing = f"; {rebuilt.unknown} commands could not be rebuilt: {rebuilt.why}" if rebuilt.unknown else ""
    return f"{n} frames, received and sent{missing}"


@contextmanager
def progress_bar(text: str, reading: "Reading") -> Iterator[None]:
    """A bar on a terminal, nothing elsewhere."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bar:
        task = bar.add_task(text, total=reading.size_bytes)
        reading.progress = lambda done: bar.update(task, completed=done)
        yield

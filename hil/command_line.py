"""What the commands share: the rig argument, its loading, and errors as one clear line."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    from servohil.hil.config import Rig

DEFAULT_RIG: Final = Path(__file__).resolve().parent.parent / "rigs" / "bench.toml"
PLANTS: Final = Path(__file__).resolve().parent.parent / "sim_bench" / "plants" / "rigs"
EXIT_REFUSED: Final = 1
RIG = click.argument("rig", type=click.Path(path_type=Path), default=DEFAULT_RIG, required=False)


@contextmanager
def one_clear_line() -> Iterator[None]:
    """Errors that a person can act on come as text without a traceback; everything else is a bug and keeps its own."""
    try:
        yield
    except KeyboardInterrupt:
        raise click.exceptions.Exit(130) from None
    except click.ClickException:
        raise
    except (OSError, ValueError) as error:
        click.echo(f"hil: {error}", err=True)
        raise click.exceptions.Exit(EXIT_REFUSED) from None


def load(path: Path) -> "Rig":
    """The rig at `path`; raises ConfigError. What is built from it may have to be compiled."""
    from servohil.hil.compile_message import say_when_compiling
    from servohil.hil.config import load_rig

    say_when_compiling()
    return load_rig(path)


def plant_file(path: Path) -> Path | None:
    """The Python file of a plant, given by its path or, for one of ours, by its name; None: `path` is a rig file."""
    if path.suffix == ".py":
        return path
    ours = PLANTS / f"{path}.py"
    return ours if path.name == str(path) and not path.exists() and ours.is_file() else None


def refuse_given(names: Sequence[str], why: str) -> None:
    """Refuse options of the running command that were given though they mean nothing here."""
    context = click.get_current_context()
    options = {option.name: option.opts[0] for option in context.command.params}
    for name in names:
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT:
            raise click.UsageError(f"{options[name]}: {why}")


def new_folder(base: str, name: str) -> Path:
    """A fresh folder for one run, named by UTC time."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime())
    for attempt in range(100):
        folder = Path(base) / (f"{stamp}-{name}" if not attempt else f"{stamp}-{name}-{attempt}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise OSError(f"{base}: no free folder name for {stamp}-{name}")

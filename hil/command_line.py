"""What the commands share: the rig argument, its loading, and errors as one clear line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

if TYPE_CHECKING:
    from servohil.hil.config import Rig

DEFAULT_RIG: Final = Path(__file__).resolve().parent.parent / "rigs" / "bench.toml"
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

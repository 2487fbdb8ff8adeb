"""Says on stderr that a filter is being compiled: the first start with a model takes seconds more than the others."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import click


@contextmanager
def compile_message(name: str) -> Iterator[None]:
    """A line before, and one with the time it took; `specialise.on_compile`."""
    click.echo(f"hil: compiling {name} for this model, once; it takes some seconds", err=True)
    start = time.monotonic()
    yield
    click.echo(f"hil: compiled {name} in {time.monotonic() - start:.1f} s", err=True)


def say_when_compiling() -> None:
    """From now on. Imports numba, as the command that needs it is about to do anyway."""
    from servohil.estimators.compilation import specialise

    specialise.on_compile = compile_message

"""Read and validate a rig file: every mistake at once, one line each."""

import re
import tomllib
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from servohil.hil.config.problems import from_pydantic
from servohil.hil.config.relations import violated
from servohil.hil.config.rig import Rig
from servohil.hil.small_file import FileTooLargeError, read_small_text

RIG_BYTES: Final = 48 << 20  # with the samples of a trajectory in it; without, a rig file has a few kB
DEEPEST: Final = 16  # tables and arrays within each other; a rig file has four
TOO_DEEP: Final = f"nested too deeply; allowed: {DEEPEST} tables and arrays within each other"


class ConfigError(ValueError):
    """The configuration cannot be used. One line per mistake: file, dotted key, value, what is allowed."""


def load_rig(path: str | Path) -> Rig:
    """The validated rig of the TOML file at `path`.

    Raises:
        ConfigError: the file is missing or unreadable, is not TOML, or breaks a rule; all mistakes are listed.
    """
    path = Path(path)
    raw = _read(path)
    problems = []
    sections: dict[str, Any] = {}
    try:
        rig = Rig.model_validate(raw)
        sections = {name: getattr(rig, name) for name in Rig.model_fields}
    except ValidationError as error:
        found = error.errors()
        problems += from_pydantic(found, raw, Rig)
        sections = _valid_sections(raw, broken={str(detail["loc"][0]) for detail in found})
    problems += violated(sections, path.parent)
    if problems:
        raise ConfigError("\n".join(problem.line(str(path), raw) for problem in problems))
    return rig.at(path)


def _valid_sections(raw: dict[str, Any], broken: set[str]) -> dict[str, Any]:
    """The tables of `raw` without a mistake of their own, so that what relates them can still be checked."""
    return {
        name: TypeAdapter[Any](field.annotation or object).validate_python(raw[name])
        for name, field in Rig.model_fields.items()
        if name in raw and name not in broken and name != "name"
    }


def _read(path: Path) -> dict[str, Any]:
    try:
        text = read_small_text(path, RIG_BYTES)
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except FileTooLargeError as error:
        raise ConfigError(str(error)) from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is not UTF-8 text; allowed: a TOML file in UTF-8") from None
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        # Python 3.11 gives the place as text only: "... (at line 3, column 5)" or "... (at end of document)".
        reason, _, place = str(error).rpartition(" (at ")
        line = re.match(r"line (\d+)", place)
        number = int(line.group(1)) if line else text.count("\n") + 1
        raise ConfigError(f"{path}: line {number}: not TOML: {reason[:1].lower()}{reason[1:]}") from None
    except RecursionError:
        raise ConfigError(f"{path}: {TOO_DEEP}") from None
    except ValueError as error:  # a number of thousands of digits
        raise ConfigError(f"{path}: {error}") from None
    level: list[Any] = [raw]
    for _ in range(DEEPEST):
        tables = [node.values() if isinstance(node, dict) else node for node in level]
        level = [node for table in tables for node in table if isinstance(node, dict | list)]
    if level:
        raise ConfigError(f"{path}: {TOO_DEEP}")
    return raw

"""Read and validate a rig file: every mistake at once, one line each."""

import re
import tomllib
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter, ValidationError

from servohil.hil.config.problems import from_pydantic
from servohil.hil.config.relations import violated
from servohil.hil.config.rig import Rig

MAX_BYTES: Final = 16_000_000  # the samples of a long trajectory fit


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
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise ConfigError(f"{path}: {size} bytes; allowed: a TOML file of up to {MAX_BYTES} bytes")
        text = path.read_bytes().decode("utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is not UTF-8 text; allowed: a TOML file in UTF-8") from None
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ConfigError(f"{path}: not TOML that anybody needs: arrays or tables nested too deep") from None
    except ValueError as error:  # of TOML, and of Python for a number of thousands of digits
        # Python 3.11 gives the place as text only: "... (at line 3, column 5)" or "... (at end of document)".
        reason, _, place = str(error).rpartition(" (at ")
        line = re.match(r"line (\d+)", place)
        number = int(line.group(1)) if line else text.count("\n") + 1
        raise ConfigError(f"{path}: line {number}: not TOML: {reason[:1].lower()}{reason[1:]}") from None

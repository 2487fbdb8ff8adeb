"""Mistakes in a configuration as text: one line each, with the key, the value and what is allowed."""

import json
import re
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any, Literal, NamedTuple, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from servohil.hil.quantity import dimension_of

MAX_VALUE_CHARACTERS = 60
Path = tuple[int | str, ...]  # keys and array positions from the top of the file

# pydantic's wording where ours is plainer.
WORDING = {
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be a text",
    "bool_type": "must be true or false",
    "model_type": "must be a table",
    "dict_type": "must be a table",
    "tuple_type": "must be an array",
    "too_short": "must not be empty",
}


class Problem(NamedTuple):
    """One mistake: where, and what is allowed there."""

    path: Path
    text: str

    def line(self, file: str, raw: Mapping[str, Any]) -> str:
        """The mistake as one line, with the value that `raw`, the file's content, has at that place."""
        node: Any = raw
        for part in self.path:
            inside = isinstance(part, int) if isinstance(node, list) else isinstance(node, Mapping) and part in node
            if not inside:
                return f"{file}: {dotted(self.path)}: {self.text}"
            node = node[part]
        return f"{file}: {dotted(self.path)} = {shown(node)}: {self.text}"


def shown(value: object) -> str:
    """A value much as a TOML file writes it, cut to a readable length."""
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= MAX_VALUE_CHARACTERS else text[: MAX_VALUE_CHARACTERS - 4].rstrip() + " ..."


def dotted(path: Path) -> str:
    """`path` as a dotted key."""
    text = ""
    for part in path:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.removeprefix(".")


def from_pydantic(errors: Iterable[ErrorDetails], raw: Mapping[str, Any], root: type[BaseModel]) -> list[Problem]:
    """Translate pydantic's findings on the table `raw`, validated as `root`."""
    return [_translate(error, raw, root) for error in errors]


def _translate(error: ErrorDetails, raw: Mapping[str, Any], root: type[BaseModel]) -> Problem:
    path = _real_path(error["loc"], raw)
    match error["type"]:
        case "missing":
            return Problem(path, f"missing; allowed: {_allowed_at(path, raw, root)}")
        case "extra_forbidden":
            return Problem(path, _unknown_key(str(path[-1]), _known_keys(path[:-1], raw, root)))
        case "union_tag_not_found":
            tag, values = _tag(path, raw, root)
            return Problem((*path, tag), "missing; allowed: " + " or ".join(values))
        case "union_tag_invalid":
            tag, values = _tag(path, raw, root)
            return Problem((*path, tag), "must be " + " or ".join(values))
        case "value_error":
            return Problem(path, str(error["ctx"]["error"]))
        case kind:
            return Problem(path, WORDING.get(kind) or re.sub(r"^\w+ should ", "must ", error["msg"]))


def _real_path(loc: Path, raw: Mapping[str, Any]) -> Path:
    """`loc` without what pydantic puts in for the alternative it chose: names that the file does not have."""
    path: list[int | str] = []
    node: Any = raw
    for position, part in enumerate(loc):
        if isinstance(node, Mapping):
            if part not in node and position < len(loc) - 1:
                continue
            node = node.get(part)
        elif isinstance(node, list) and isinstance(part, int):
            node = node[part]
        path.append(part)
    return tuple(path)


def _models_at(annotation: Any) -> list[type[BaseModel]]:
    """Every model class inside a type such as `Plant | None`, `dict[str, Message]` or a union of two tables."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_at(argument)]


def _tables_at(path: Path, raw: Mapping[str, Any], root: type[BaseModel]) -> list[type[BaseModel]]:
    """The model classes that the table at `path` may be; one, unless the key that tells them apart is missing."""
    tables = [root]
    node: Any = raw
    for part in path:
        node = node.get(part) if isinstance(node, Mapping) else None
        fields = [table.model_fields[str(part)] for table in tables if part in table.model_fields]
        if fields:  # otherwise `part` is the free name of an entry, as in bus.messages.Position
            tables = [model for field in fields for model in _models_at(field.annotation)]
        if len(tables) > 1 and isinstance(node, Mapping):
            tag = _tag_of(tables)
            tables = [table for table in tables if node.get(tag) in get_args(table.model_fields[tag].annotation)]
    return tables


def _tag_of(tables: list[type[BaseModel]]) -> str:
    """The key that tells alternative tables apart: the first of each, e.g. "kind" or "law"."""
    return next(iter(tables[0].model_fields))


def _tag(path: Path, raw: Mapping[str, Any], root: type[BaseModel]) -> tuple[str, list[str]]:
    """The key that chooses between the tables possible at `path`, and its values, quoted."""
    models = [
        model
        for table in _tables_at(path[:-1], raw, root)
        for model in _models_at(table.model_fields[str(path[-1])].annotation)
    ]
    tag = _tag_of(models)
    return tag, [repr(value) for model in models for value in get_args(model.model_fields[tag].annotation)]


def _unknown_key(key: str, known: list[str]) -> str:
    near = get_close_matches(key, known, n=1, cutoff=0.5)
    return f"unknown key; did you mean {near[0]}?" if near else f"unknown key; allowed: {', '.join(known)}"


def _known_keys(path: Path, raw: Mapping[str, Any], root: type[BaseModel]) -> list[str]:
    return [key for table in _tables_at(path, raw, root) for key in table.model_fields]


def _allowed_at(path: Path, raw: Mapping[str, Any], root: type[BaseModel]) -> str:
    """What may stand at the missing key `path`."""
    key = str(path[-1])
    dimension = dimension_of(key)
    if dimension is not None:
        return dimension.allowed()
    table = next(table for table in _tables_at(path[:-1], raw, root) if key in table.model_fields)
    annotation: Any = table.model_fields[key].annotation
    if get_origin(annotation) is Literal:
        return " or ".join(repr(choice) for choice in get_args(annotation))
    if _models_at(annotation):
        return f"a table [{dotted(path)}]"
    if get_origin(annotation) is tuple:
        return "an array"
    return {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}.get(annotation, "a value")

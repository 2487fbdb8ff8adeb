"""The one format of results, `{"provenance": {...}, "claims": [{"id", "value", "unit", "limit", "holds", "how"}]}`.

Whether a claim holds is computed from its value and its limit and checked again at reading: a file cannot say "holds"
beside a value that breaks the limit. Pages in docs/ are made from these files, between markers.
"""

import json
import os
import re
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from math import isfinite
from pathlib import Path
from typing import Any, Final, Self

VALUE_TYPES: Final = "a finite number, a text, true, false or null"
Value = float | int | str | bool | None

ID: Final = re.compile(r"[a-z0-9][a-z0-9._-]*")
NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
BOUND: Final = re.compile(rf"(<=|>=|<|>|==)\s*({NUMBER})")
RANGE: Final = re.compile(rf"({NUMBER})\s*\.\.\s*({NUMBER})")
EXACT: Final = re.compile(r"==\s*(\S.*)")
LIMIT_FORMS: Final = '"<= 1", "< 1", ">= 1", "> 1", "== 1", "0.9 .. 1.1" or "== TEXT"'


class ClaimError(ValueError):
    """A claim or a results file breaks the format; the message names file, claim, value and what is allowed."""


def is_within(value: Value, limit: str) -> bool:
    """Whether `value` keeps to `limit`. A value that is null ("not measured") keeps to nothing.

    Args:
        value: a number for the numeric forms, a text or truth value for "== TEXT".
        limit: one of the forms of LIMIT_FORMS; numbers in the unit of the value; bounds of ".." are inclusive.

    Raises:
        ClaimError: the limit has none of the forms, or asks for a number where the value is none.
    """
    bound, span, exact = BOUND.fullmatch(limit), RANGE.fullmatch(limit), EXACT.fullmatch(limit)
    if bound is None and span is None and exact is None:
        raise ClaimError(f"limit {limit!r}: expected {LIMIT_FORMS}")
    if value is None:
        return False
    if isinstance(value, bool | str):
        if exact is None:
            raise ClaimError(f"limit {limit!r}: asks for a number, the value is {value!r}")
        return exact[1] == (value if isinstance(value, str) else str(value).lower())
    if span is not None:
        return float(span[1]) <= value <= float(span[2])
    if bound is None:
        raise ClaimError(f"limit {limit!r}: asks for a text, the value is {value!r}")
    number = float(bound[2])
    match bound[1]:
        case "<=":
            return value <= number
        case ">=":
            return value >= number
        case "<":
            return value < number
        case ">":
            return value > number
        case _:
            return value == number


@dataclass(frozen=True)
class Claim:
    """One figure or statement, what it must keep to, and how it was found.

    Attributes:
        id: unique within a file, e.g. "bench.tracking.rmse"; lower case letters, digits, ".", "_", "-".
        value: a number, a text or a truth value; None where it could not be measured.
        unit: SI unit or a named multiple of it ("us", "%"); "1" for a count or a ratio, "" for texts.
        limit: see LIMIT_FORMS; None for a figure that is only reported.
        holds: whether value keeps to limit; None exactly where there is no limit.
        how: one sentence: the command, the conditions, the number of samples.

    Raises:
        ClaimError: a field has the wrong type or form, or `holds` contradicts value and limit.
    """

    id: str
    value: Value
    unit: str
    limit: str | None
    holds: bool | None
    how: str

    def __post_init__(self) -> None:
        if not isinstance(self.id, str) or ID.fullmatch(self.id) is None:
            raise ClaimError(f"claim id {self.id!r}: expected lower case letters, digits, '.', '_' and '-'")
        where = f"claim {self.id!r}"
        if self.value is not None and not isinstance(self.value, bool | int | float | str):
            raise ClaimError(f"{where}: value {self.value!r}: expected {VALUE_TYPES}")
        if isinstance(self.value, float) and not isfinite(self.value):
            raise ClaimError(f"{where}: value {self.value!r}: expected {VALUE_TYPES} (null: not measured)")
        for name in ("unit", "how"):
            if not isinstance(getattr(self, name), str):
                raise ClaimError(f"{where}: {name} {getattr(self, name)!r}: expected a text")
        if not self.how.strip():
            raise ClaimError(f"{where}: how is empty: say how the value was found")
        if self.limit is not None and not isinstance(self.limit, str):
            raise ClaimError(f"{where}: limit {self.limit!r}: expected {LIMIT_FORMS}, or null")
        try:
            expected = None if self.limit is None else is_within(self.value, self.limit)
        except ClaimError as error:
            raise ClaimError(f"{where}: {error}") from None
        if self.holds is not expected:
            raise ClaimError(
                f"{where}: holds is {json.dumps(self.holds, default=repr)}, but value {self.value!r} and "
                f"limit {self.limit!r} give {json.dumps(expected)}"
            )

    @classmethod
    def judge(cls, id: str, value: Value, unit: str, limit: str | None, how: str) -> Self:
        """A claim whose `holds` follows from value and limit."""
        try:
            holds = None if limit is None else is_within(value, limit)
        except ClaimError as error:
            raise ClaimError(f"claim {id!r}: {error}") from None
        return cls(id, value, unit, limit, holds, how)


def write_atomically(path: Path, text: str) -> None:
    """Write a file so that a reader, or a power cut, finds either the old content or the new one, never a part.

    Raises:
        OSError: the folder does not exist or cannot be written.
    """
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
            os.fchmod(file.fileno(), 0o644)  # mkstemp gives 0600; results are meant to be shared
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _refuse_duplicates(claims: Iterable[Claim], where: str) -> None:
    seen: set[str] = set()
    for claim in claims:
        if claim.id in seen:
            raise ClaimError(f"{where}: claim id {claim.id!r} stands twice; ids are unique within a file")
        seen.add(claim.id)


def write_claims(path: Path, claims: Iterable[Claim], provenance: Mapping[str, Any]) -> None:
    """Write a results file atomically, claims in the order given.

    Raises:
        ClaimError: an id stands twice, or the provenance holds something JSON has no form for.
        OSError: the folder does not exist or cannot be written.
    """
    listed = list(claims)
    _refuse_duplicates(listed, str(path))
    document = {"provenance": dict(provenance), "claims": [asdict(claim) for claim in listed]}
    try:
        text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise ClaimError(f"{path}: provenance: {error}") from None
    write_atomically(path, text)


def _claim_from(entry: Any, where: str) -> Claim:
    expected = [field.name for field in fields(Claim)]
    if not isinstance(entry, dict):
        raise ClaimError(f"{where}: expected an object with {', '.join(expected)}")
    wrong = sorted(set(entry) ^ set(expected))
    if wrong:
        what = ", ".join(f"{'unknown' if key in entry else 'missing'} key {key!r}" for key in wrong)
        raise ClaimError(f"{where}: {what}; expected {', '.join(expected)}")
    try:
        return Claim(**entry)
    except ClaimError as error:
        raise ClaimError(f"{where}: {error}") from None


def read_claims(path: Path) -> tuple[list[Claim], dict[str, Any]]:
    """Read and validate a results file: (claims, provenance).

    Raises:
        ClaimError: not JSON, wrong shape, or a claim that breaks the format; the message names the file and the entry.
        OSError: the file cannot be read.
    """
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ClaimError(f"{path}: not JSON: {error}") from None
    if not isinstance(document, dict) or set(document) != {"provenance", "claims"}:
        raise ClaimError(f"{path}: expected an object with exactly the keys 'provenance' and 'claims'")
    if not isinstance(document["provenance"], dict):
        raise ClaimError(f"{path}: provenance: expected an object")
    if not isinstance(document["claims"], list):
        raise ClaimError(f"{path}: claims: expected a list")
    claims = [_claim_from(entry, f"{path}: claims[{index}]") for index, entry in enumerate(document["claims"])]
    _refuse_duplicates(claims, str(path))
    return claims, document["provenance"]

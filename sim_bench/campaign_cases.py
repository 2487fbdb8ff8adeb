"""The cases of a campaign: what one may hold, when two are the same, and the random numbers that belong to it."""

import hashlib
import json
from collections.abc import Iterable, Mapping
from itertools import product
from math import isnan
from typing import Any, Final

from servohil.sim_bench.campaign_table import Row, column_type, plain_value

Case = Mapping[str, Any]

SEED: Final = "seed"  # the table's own column


class CampaignError(ValueError):
    """A case, a result or the folder cannot be used; the message names it and what is allowed."""


def grid(**axes: Iterable[Any]) -> list[dict[str, Any]]:
    """All combinations, e.g. grid(scenario=("p1", "p3"), run=range(20)); the last axis turns fastest."""
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]


def case_seed(case: Case, seed: int) -> int:
    """The seed of a case, below 2**63: its generator is `np.random.default_rng(case_seed(case, seed))`.

    Raises:
        CampaignError: the case cannot be used.
    """
    return int(case_digest(plain_case(case), seed)[:16], 16) >> 1


def case_digest(case: Row, seed: int) -> str:
    """SHA-256 of the campaign's seed and the content of a checked case, whatever the order of its keys."""
    whole = {k: int(v) if isinstance(v, float) and v.is_integer() else v for k, v in case.items()}  # 1 is 1.0
    return hashlib.sha256(json.dumps([seed, whole], sort_keys=True).encode()).hexdigest()


def case_order(case: Row) -> list[tuple[str, Any]]:
    """Sorts checked cases by content, keys in alphabetical order, numbers as numbers."""
    return sorted(case.items())


def plain_row(values: Mapping[str, Any], what: str) -> Row:
    """The values as plain str, bool, int, float or None.

    Raises:
        CampaignError: a name or a value is something else; the message calls it `what`.
    """
    for name in values:
        if not isinstance(name, str) or not name:
            raise CampaignError(f"{what} {name!r}: expected a text as its name")
    try:
        return {name: plain_value(value) for name, value in values.items()}
    except ValueError as error:
        raise CampaignError(f"{what} in {dict(values)!r}: {error}") from None


def plain_case(case: Case) -> Row:
    """A case with plain values.

    Raises:
        CampaignError: it is empty, has a key "seed", or a value that is no text, truth value or number.
    """
    plain = plain_row(case, "case key")
    for name, value in plain.items():
        if value is None or (isinstance(value, float) and isnan(value)):
            raise CampaignError(f"case {plain!r}: {name} is {value!r}: expected a text, truth value or number")
    if SEED in plain or not plain:
        raise CampaignError(f"case {plain!r}: needs at least one key, and none named {SEED!r}")
    return plain


def plain_cases(cases: Iterable[Case], seed: int) -> dict[str, Row]:
    """All cases with plain values by their digest, sorted by content.

    Raises:
        CampaignError: no cases, one that cannot be used or stands twice, or a key with texts here and numbers there.
    """
    found: dict[str, Row] = {}
    for case in cases:
        plain = plain_case(case)
        if found.setdefault(case_digest(plain, seed), plain) is not plain:
            raise CampaignError(f"case {plain!r} stands twice; give repetitions a key of their own, e.g. 'run'")
    if not found:
        raise CampaignError("a campaign needs at least one case")
    for name in {name for case in found.values() for name in case}:
        try:
            column_type(name, [case.get(name) for case in found.values()])
        except ValueError as error:
            raise CampaignError(f"cases: {error}") from None
    return dict(sorted(found.items(), key=lambda item: case_order(item[1])))

"""Pages in docs/ made from results files: a Markdown table of claims, and its place in a page between two markers."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from servohil.hil.claims import Claim, ClaimError, Value, write_atomically

HEAD: Final = "| claim | value | limit | holds | how |\n|---|---:|---|---|---|\n"


def value_text(value: Value, unit: str = "") -> str:
    """A value for people: four significant digits, integers in full, "not measured" for None; the unit behind it."""
    if value is None:
        return "not measured"
    if isinstance(value, bool):
        return "yes" if value else "no"
    number = f"{value:.4g}" if isinstance(value, float) else str(value)
    return number if unit in {"", "1"} else f"{number} {unit}"


def _cell(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())


def claims_table(claims: Iterable[Claim]) -> str:
    """The claims as a Markdown table, one row each, in the order given; ends in a newline."""
    rows = []
    for claim in claims:
        verdict = {True: "yes", False: "**no**", None: ""}[claim.holds]
        limit = "" if claim.limit is None else f"{claim.limit} {'' if claim.unit == '1' else claim.unit}"
        cells = (f"`{claim.id}`", value_text(claim.value, claim.unit), limit, verdict, claim.how)
        rows.append("| " + " | ".join(_cell(cell) for cell in cells) + " |\n")
    return HEAD + "".join(rows)


def _emphasised(claim: Claim) -> str:
    text = value_text(claim.value, claim.unit)
    return f"**{text}**" if claim.holds is False else text


def claims_grid(claims: Iterable[Claim]) -> str:
    """Claims whose ids differ in their last part only share a row, one column for each last part; ends in a newline.

    A value that breaks its limit is bold; the row gives the limit of its first claim. How they were found stands below,
    once each: it is the same for many.
    """
    rows: dict[str, dict[str, Claim]] = {}
    for claim in claims:
        row, _, column = claim.id.rpartition(".")
        rows.setdefault(row, {})[column] = claim
    columns = list(dict.fromkeys(column for row in rows.values() for column in row))
    lines = [f"| claims | {' | '.join(columns)} | limit |\n", f"|---|{'---:|' * len(columns)}---|\n"]
    found: dict[str, list[str]] = {}
    for name, of_row in rows.items():
        first = next(iter(of_row.values()))
        found.setdefault(first.how, []).append(name)
        values = [_emphasised(of_row[column]) if column in of_row else "" for column in columns]
        lines.append("| " + " | ".join(_cell(cell) for cell in (f"`{name}`", *values, first.limit or "")) + " |\n")
    notes = [f"- {', '.join(f'`{name}`' for name in names)}: {how}\n" for how, names in found.items()]
    return "".join([*lines, "\n", *notes])


def between_markers(page: str, marker: str, text: str, where: str = "page") -> str:
    """`page` with everything between `<!-- begin MARKER -->` and `<!-- end MARKER -->` replaced by `text`.

    Raises:
        ClaimError: a marker is missing, stands twice, or the end stands before the begin.
    """
    begin, end = f"<!-- begin {marker} -->", f"<!-- end {marker} -->"
    for tag in (begin, end):
        if page.count(tag) != 1:
            raise ClaimError(f"{where}: marker {tag!r} stands {page.count(tag)} times; expected once")
    start, stop = page.index(begin) + len(begin), page.index(end)
    if stop < start:
        raise ClaimError(f"{where}: marker {end!r} stands before {begin!r}")
    return f"{page[:start]}\n{text.strip()}\n{page[stop:]}"


def update_page(path: Path, marker: str, text: str) -> bool:
    """Replace the text between the markers of a page, atomically; returns whether the page changed.

    Raises:
        ClaimError: see between_markers.
        OSError: the page cannot be read or written.
    """
    old = path.read_text(encoding="utf-8")
    new = between_markers(old, marker, text, str(path))
    if new != old:
        write_atomically(path, new)
    return new != old

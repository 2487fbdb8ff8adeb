"""The claims of `hil evaluate control` as Markdown: a table per scenario, a row per law."""

from collections.abc import Sequence

from servohil.hil.claims import Claim
from servohil.hil.claims_page import value_text

HEADS = {
    "rmse_mm": "RMSE, mm", "settling_s": "settling, s", "chatter_mv": "chatter, mV", "effort_v": "effort, V",
    "peak_mm": "peak, mm",
}  # fmt: skip


def control_tables(claims: Sequence[Claim]) -> str:
    """A table per scenario; what breaks its limit is bold, "-" is a run that ended in a fault or never settled."""
    scenarios: dict[str, dict[str, dict[str, Claim]]] = {}
    for claim in claims:
        _, scenario, law, metric = claim.id.split(".")
        scenarios.setdefault(scenario, {}).setdefault(law, {})[metric] = claim
    lines = []
    for scenario, laws in scenarios.items():
        how = next(iter(next(iter(laws.values())).values())).how.split("; ", 1)[1]
        lines += [
            f"**{scenario}**: {how}",
            "",
            f"| law | {' | '.join(HEADS.values())} |",
            f"|---|{'---:|' * len(HEADS)}",
        ]
        for law, of_law in laws.items():
            lines.append(f"| {law} | {' | '.join(_cell(of_law[metric]) for metric in HEADS)} |")
        lines.append("")
    limits = [f"{c.id}: {c.limit} {c.unit}: {'holds' if c.holds else '**does not hold**'}" for c in claims if c.limit]
    return "\n".join([*lines, *(f"- {limit}" for limit in limits), ""])


def _cell(claim: Claim) -> str:
    text = "-" if claim.value is None else value_text(claim.value)
    return f"**{text}**" if claim.holds is False else text

"""The bench's report: figures from two logs, verdicts, and a page to show. matplotlib is loaded only for the page."""

from servohil.sim_bench.report.score import RunFacts, WarmUp, deterministic_part, score
from servohil.sim_bench.report.verdicts import Limits, add_verdicts, summary_lines, verdict_claims

__all__ = [
    "Limits",
    "RunFacts",
    "WarmUp",
    "add_verdicts",
    "deterministic_part",
    "score",
    "summary_lines",
    "verdict_claims",
]

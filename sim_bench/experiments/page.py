"""The page of a paper: the printed figures and ours side by side, a verdict per claim, what had to be chosen."""

from collections.abc import Mapping, Sequence

import numpy as np

from servohil.sim_bench.experiments.experiment import NOT_TESTABLE, Experiment, Results


def value(number: float | None) -> str:
    """Three significant digits; "NaN" for what the paper has so."""
    if number is None:
        return "NaN"
    return f"{number:.3g}" if 1e-3 <= abs(number) < 1e4 or number == 0.0 else f"{number:.1e}"


def spread(column: np.ndarray) -> str:
    """Median, and the range from 5 to 95 % behind it."""
    low, middle, high = np.percentile(column, [5.0, 50.0, 95.0])
    return f"{value(middle)} ({value(low)} .. {value(high)})"


def section(experiment: Experiment, results: Results, figures: Mapping[str, str]) -> str:
    """One experiment in Markdown; captions by file name."""
    lines = [f"## {experiment.id}: {experiment.title}", "", f"{experiment.source}.", ""]
    if results:
        lines += [
            f"| {experiment.metric.name}: printed / median (5 .. 95 %) here | {' | '.join(experiment.states)} |",
            f"|---|{'---|' * len(experiment.states)}",
        ]
        for name, result in results.items():
            printed = experiment.printed.get(name)
            cells = [
                f"{value(printed[i]) if printed and i < len(printed) else '-'} / {spread(result.whole[:, i])}"
                for i in range(len(experiment.states))
            ]
            lines.append(f"| {name} | {' | '.join(cells)} |")
        lines.append("")
    for file, caption in figures.items():
        lines += [f"![{caption}]({file})", "", f"*{caption}*", ""]
    for claim in experiment.claims:
        verdict = claim.verdict(results)
        why = f": {claim.why}" if verdict == NOT_TESTABLE else ""
        lines.append(f"- **{verdict}**{why}: {claim.text}.")
    lines += ["", *experiment.notes, ""]
    return "\n".join(lines)


def verdict_table(experiments: Sequence[Experiment], results: Mapping[str, Results]) -> str:
    """Every claim with its verdict."""
    lines = ["| experiment | claim | verdict |", "|---|---|---|"]
    for experiment in experiments:
        for claim in experiment.claims:
            verdict = claim.verdict(results.get(experiment.id, {}))
            lines.append(f"| {experiment.id} | {claim.text} | {verdict} |")
    return "\n".join(lines)


def page(
    title: str, experiments: Sequence[Experiment], results: Mapping[str, Results],
    figures: Mapping[str, Mapping[str, str]], facts: str,
) -> str:  # fmt: skip
    """The whole page in Markdown.

    Args:
        title: of the paper.
        experiments: in the order of the page.
        results: by experiment; one that cannot be tested has none.
        figures: captions by experiment and file name.
        facts: how, when and on what machine; run time.
    """
    parts = [f"# {title}", "", facts, "", "## Verdicts", "", verdict_table(experiments, results), ""]
    parts += [section(each, results.get(each.id, {}), figures.get(each.id, {})) for each in experiments]
    return "\n".join(parts).rstrip() + "\n"

"""matplotlib drawings as SVG inside a page that follows the reader's light or dark setting.

Colours are drawn as place-holders and replaced by CSS variables, so one drawing serves both; text stays text.
"""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROLES: Final = (
    "paper",
    "ink",
    "soft",
    "grid",
    "true",
    "estimated",
    "measured",
    "reference",
    "side-a",
    "side-b",
    "limit",
    "good",
    "hold",
    "idle",
)
# Colours nobody would choose, one per role.
COLOUR: Final = {role: f"#0b{index:02x}d7" for index, role in enumerate(ROLES, start=1)}

STYLE: Final[dict[Any, Any]] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib; wider than the reader's font, so nothing runs over
    "font.size": 9.0,
    "svg.fonttype": "none",
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "axes.edgecolor": COLOUR["grid"],
    "axes.labelcolor": COLOUR["soft"],
    "axes.titlecolor": COLOUR["ink"],
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "grid.color": COLOUR["grid"],
    "grid.linewidth": 0.6,
    "xtick.color": COLOUR["grid"],
    "ytick.color": COLOUR["grid"],
    "xtick.labelcolor": COLOUR["soft"],
    "ytick.labelcolor": COLOUR["soft"],
    "text.color": COLOUR["soft"],
    "legend.frameon": False,
    "legend.handlelength": 1.6,
    "legend.borderaxespad": 0.0,
    "lines.linewidth": 1.2,
    "path.simplify": True,
    "path.simplify_threshold": 0.25,
}


@contextmanager
def drawing() -> Iterator[None]:
    """matplotlib settings of our drawings, for the time of a `with` block."""
    import matplotlib as mpl

    # Not the reader's own matplotlibrc; and not the back end, whose choice would import pyplot.
    settings: dict[Any, Any] = {k: v for k, v in mpl.rcParamsDefault.items() if not k.startswith("backend")}
    with mpl.rc_context({**settings, **STYLE}):
        yield


def inline_svg(figure: "Figure", name: str, label: str) -> str:
    """The figure as one <svg> element: themed, without identifiers that two figures on a page could share.

    Args:
        figure: drawn inside `drawing()`.
        name: unique on the page; goes into the identifiers that are needed.
        label: for readers who do not see it.
    """
    import matplotlib as mpl

    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    for role, colour in COLOUR.items():
        text = text.replace(colour, f"var(--{role})")
    used = set(re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', text))
    kept = {name for pair in used for name in pair if name}
    text = re.sub(r' id="([^"]+)"', lambda match: match[0] if match[1] in kept else "", text)
    # the page gives the size; the drawing keeps its proportions
    text = re.sub(r'^<svg ([^>]*?)width="[^"]*"', r"<svg \1", text, count=1)
    text = re.sub(r'^<svg ([^>]*?)height="[^"]*"', r"<svg \1", text, count=1)
    return text.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)

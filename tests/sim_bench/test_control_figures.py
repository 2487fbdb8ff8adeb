"""The picture of the fuzzy gain can be drawn."""

from pathlib import Path

from servohil.sim_bench.control_figures import draw_memberships


def test_the_fuzzy_gain_is_drawn(tmp_path: Path) -> None:
    draw_memberships(tmp_path / "fuzzy.png")
    assert (tmp_path / "fuzzy.png").read_bytes().startswith(b"\x89PNG")

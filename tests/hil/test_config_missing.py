"""A rig file with any one line missing loads, or says what is missing and what may stand there."""

from pathlib import Path

import pytest

from servohil.hil.config import ConfigError, load_rig

RIGS = Path(__file__).parents[2] / "rigs"


@pytest.mark.parametrize("rig", ["bench", "leakage", "bench-fd"])
def test_any_line_may_be_missing(tmp_path: Path, rig: str) -> None:
    lines = (RIGS / f"{rig}.toml").read_text().splitlines()
    for dbc in ("bench.dbc", "bench-fd.dbc"):
        (tmp_path / dbc).write_bytes((RIGS / dbc).read_bytes())
    path = tmp_path / "rig.toml"
    refused = 0
    for k, line in enumerate(lines):
        if line and not line.startswith("#"):
            path.write_text("\n".join(lines[:k] + lines[k + 1 :]))
            try:
                load_rig(path)
            except ConfigError as error:
                refused += 1
                assert all(text.startswith(f"{path}: ") for text in str(error).splitlines())
    assert refused > len(lines) / 3

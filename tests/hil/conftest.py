"""One run of a real controller for all tests that replay, export or break its recording."""

import pytest
from recorded_run import RecordedRun, recorded_run


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    """Two and a half seconds, moving from 0.06 s on."""
    return recorded_run(tmp_path_factory.mktemp("recorded-run"), 2500)

"""CAN logs as nobody should write them: read to some end, or refused by name."""

from pathlib import Path

import can
import numpy as np
import pytest
from damage import damaged_bytes

from servohil.hil.recording.can_log import CanLog, CanLogError

WRITERS = {"log": can.CanutilsLogWriter, "asc": can.ASCWriter, "blf": can.BLFWriter}
MESSAGES = 200


@pytest.mark.timeout(200)
@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("n", [60, pytest.param(10_000, marks=pytest.mark.nightly)])
def test_can_logs(tmp_path: Path, kind: str, n: int) -> None:
    random = np.random.default_rng(9)
    path = tmp_path / f"x.{kind}"
    with WRITERS[kind](str(path)) as writer:
        for k in range(MESSAGES):
            flags = {"is_extended_id": k % 3 == 0, "is_remote_frame": k % 7 == 0, "is_error_frame": k % 11 == 0}
            writer.on_message_received(
                can.Message(
                    timestamp=1e9 + k * 1e-3, arbitration_id=k, data=None if k % 7 == 0 else random.bytes(8), **flags
                )
            )
    assert sum(1 for _ in CanLog(path)) == MESSAGES
    whole = path.read_bytes()
    broken = 0
    for _ in range(n):
        path.write_bytes(damaged_bytes(random, whole))
        try:
            log = CanLog(path)
            assert sum(1 for _ in log) <= 2 * MESSAGES
            broken += bool(log.malformed or log.problem)
        except CanLogError as error:
            broken += 1
            assert str(path) in str(error)
    assert broken > n / 10

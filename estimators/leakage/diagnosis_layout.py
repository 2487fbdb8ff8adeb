"""Where things lie in the arena of the diagnosis, and in its settings. Everything in the arena is state."""

from typing import Final

from servohil.estimators.leakage.changes import N_CHANGES
from servohil.estimators.leakage.competition import WORK_SIZE
from servohil.estimators.leakage.information import INFORMATION_SIZE
from servohil.estimators.leakage.onsets import ONSETS_SIZE
from servohil.estimators.leakage.signature import SCRATCH_SIZE, M, N

C: Final = N_CHANGES

# Words at the start of the arena.
(
    MODE, CYCLES, SETTLED, BLOCK_CYCLES, SCAN_AGE, LAG, JUDGED, BEST_RATIO, BEST_AGE, BEST_CHANGE, RATIO, RATIO_CHANGE,
    RATIO_ONSET, ONSET, DETECTED, VERDICT, VERDICT_ONSET, VERDICT_AT, VERDICT_SIZE, VERDICT_STD, VERDICT_CONFIDENCE,
    VERDICTS, REST, N_WORDS,
) = range(24)  # fmt: skip
LEARNING, WATCHING, PENDING = range(3)  # MODE

KNOWN: Final = N_WORDS  # (C,) amounts that are in the model
THETA: Final = KNOWN + C  # (C,) beside them
COVARIANCE: Final = THETA + C  # (C, C)
FACTOR: Final = COVARIANCE + C * C  # (C, C) of the covariance now, for the scan
SIGNATURES: Final = FACTOR + C * C  # (C, N)
LAST_X: Final = SIGNATURES + C * N  # (N,)
BASELINE: Final = LAST_X + N  # (C,) amounts at the end of commissioning
CONFIDENCE: Final = BASELINE + C  # (C + 1,) of the changes and of none, in PENDING
SIZE: Final = CONFIDENCE + C + 1  # (C,) of each change, if it is that one
SIZE_STD: Final = SIZE + C  # (C,)
BLOCK: Final = SIZE_STD + C
SUM: Final = BLOCK + INFORMATION_SIZE
EPISODE: Final = SUM + INFORMATION_SIZE
ONSETS: Final = EPISODE + INFORMATION_SIZE
ARENA_SIZE: Final = ONSETS + ONSETS_SIZE

# Scratch: carries nothing from one step to the next.
W_PU: Final = 0
W_Y: Final = W_PU + 17
W_WHITE: Final = W_Y + M
W_SIGNATURE: Final = W_WHITE + M + M * C
W_SOLVE: Final = W_SIGNATURE + SCRATCH_SIZE
W_RECORD: Final = W_SOLVE + WORK_SIZE
W_DIAGONAL: Final = W_RECORD + INFORMATION_SIZE
W_RIGHT: Final = W_DIAGONAL + C
W_MATRIX: Final = W_RIGHT + C
W_MATRIX_2: Final = W_MATRIX + C * C
SCRATCH: Final = W_MATRIX_2 + C * C

# Settings.
DT, BLOCK_STEPS, SETTLE_STEPS, LEARN_STEPS, THRESHOLD, JUDGE_STEPS, CONFIDENT, GIVE_UP_STEPS, SCALE, GUARD_STEPS, N_SETTINGS = range(11)
PRIOR: Final = N_SETTINGS  # (C,) standard deviations at the start
RATES: Final = PRIOR + C  # (C,)
STEP_STD: Final = RATES + C  # (C,)
SETTINGS_SIZE: Final = STEP_STD + C

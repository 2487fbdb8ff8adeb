"""Where things lie in the arena of the diagnosis, in its settings and in its scratch.

Everything in the arena is state; scratch carries nothing from one step to the next.
"""

from typing import Final

from servohil.estimators.leakage.changes import N_CHANGES, N_LEAKS
from servohil.estimators.leakage.competition import WORK_SIZE
from servohil.estimators.leakage.information import INFORMATION_SIZE
from servohil.estimators.leakage.onsets import ONSETS_SIZE
from servohil.estimators.leakage.signature import N_PARAMETERS, N_U, SCRATCH_SIZE, M, N

C: Final = N_CHANGES
LEARNING, CALIBRATING, WATCHING, PENDING = range(4)  # MODE

# Words at the start of the arena; times are counts of cycles, -1: never.
(
    MODE, CYCLES, SETTLED, BLOCK_CYCLES, LEARNT, LAG_S, SCALE, SQUARES_SEEN, CHANNELS_SEEN, WORST_RATIO,
    SCAN_AGE, BEST_RATIO, BEST_AGE, BEST_CHANGE,
    RATIO, RATIO_CHANGE, REST, ONSET, DETECTED,
    VERDICT, VERDICT_ONSET, VERDICT_AT, VERDICT_SIZE, VERDICT_STD, VERDICT_CONFIDENCE, VERDICTS, UNCLEAR,
    LEVEL, LEAK, LATCHED, EPISODE_FROM, REFINE_CYCLES, WIDENED, N_WORDS,
) = range(34)  # fmt: skip

KNOWN: Final = N_WORDS  # (C,) amounts that are in the model
THETA: Final = KNOWN + C  # (C,) what the baseline filter says is beside them
COVARIANCE: Final = THETA + C  # (C, C) of theta
FACTOR: Final = COVARIANCE + C * C  # (C, C) lower factor of it with the drift up to now, for the scan
SIGNATURES: Final = FACTOR + C * C  # (C, N)
BASELINE: Final = SIGNATURES + C * N  # (N_LEAKS,) leaks at the end of commissioning
NAMED: Final = BASELINE + N_LEAKS  # (N_LEAKS,) 1 once a leak was found by name
DIFFERENCE_PA: Final = NAMED + N_LEAKS  # (N_LEAKS,) mean pressure difference that drives each leak
COEFFICIENT: Final = DIFFERENCE_PA + N_LEAKS  # (N_LEAKS,) m3/(s Pa) above the baseline
COEFFICIENT_STD: Final = COEFFICIENT + N_LEAKS
FLOW: Final = COEFFICIENT_STD + N_LEAKS  # (N_LEAKS,) m3/s at that difference
CONFIDENCE: Final = FLOW + N_LEAKS  # (C + 1,) of each change and of none, in PENDING
SIZE: Final = CONFIDENCE + C + 1  # (C,) of each change, if it is that one
SIZE_STD: Final = SIZE + C
BLOCK: Final = SIZE_STD + C  # information of the block that is being filled
SUM: Final = BLOCK + INFORMATION_SIZE  # of the youngest blocks, in the scan
EPISODE: Final = SUM + INFORMATION_SIZE  # since something changed
ONSETS: Final = EPISODE + INFORMATION_SIZE
ARENA_SIZE: Final = ONSETS + ONSETS_SIZE

W_PU: Final = 0  # parameters and input that the model is run with
W_Y: Final = W_PU + N_PARAMETERS + N_U
W_LAST_X: Final = W_Y + M
W_WHITE: Final = W_LAST_X + N
W_SIGNATURE: Final = W_WHITE + M + M * C
W_SOLVE: Final = W_SIGNATURE + SCRATCH_SIZE
W_RECORD: Final = W_SOLVE + WORK_SIZE
W_DIAGONAL: Final = W_RECORD + INFORMATION_SIZE
W_RIGHT: Final = W_DIAGONAL + C
W_MATRIX: Final = W_RIGHT + C
W_FACTOR: Final = W_MATRIX + C * C
WORK: Final = W_FACTOR + C * C

(
    DT_S, BLOCK_STEPS, SETTLE_STEPS, LEARN_STEPS, THRESHOLD, GUARD_STEPS, JUDGE_STEPS, GIVE_UP_STEPS, CONFIDENT,
    WARN, ALARM, EXPECTED_RATIO, N_NUMBERS,
) = range(13)  # fmt: skip
PRIOR: Final = N_NUMBERS  # (C,) standard deviations at the start
DRIFT: Final = PRIOR + C  # (C,) per square root of a second
STEP: Final = DRIFT + C  # (C,) standard deviation of a sudden change
SETTINGS_SIZE: Final = STEP + C

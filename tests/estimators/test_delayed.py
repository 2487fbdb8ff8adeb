import numpy as np
import pytest
from hydraulic_bench import MEASUREMENT_STD, P0, PROCESS_STD, X0, healthy_motion, model, srukf

from servohil.estimators import ASRUKF
from servohil.estimators.arena import arena_offsets
from servohil.estimators.delayed import DelayedFilter, _mark
from servohil.estimators.health import Status

NAN = float("nan")
DEPTH = 12


def arriving(samples, seed):
    """Split each sample into what is there in time and a list of (age, y) that comes at each later step."""
    rng = np.random.default_rng(seed)
    in_time, late = samples.copy(), [[] for _ in samples]
    for k in range(len(samples)):
        for channels in ([1], [2]):
            age = int(rng.integers(0, DEPTH))
            if k + age < len(samples) and rng.random() < 0.7:
                y = np.full(3, NAN)
                y[channels] = samples[k, channels]
                late[k + age].append((age, y))
                in_time[k, channels] = NAN
    return in_time, late


def change(k, ukf):
    """What an operator does between the steps."""
    if k == 40:
        ukf.Q = 9 * np.diag(PROCESS_STD**2)
    if k == 43:
        ukf.R = 4 * np.diag(MEASUREMENT_STD**2)
    if k == 90:
        ukf.Q = np.diag(PROCESS_STD**2)


def test_equals_the_filter_that_had_it_all_in_time_bit_for_bit():
    inputs, samples, _ = healthy_motion(150)
    samples[30] = NAN
    samples[60, 0] = np.inf
    inputs[70] = NAN
    samples[80:83, 0] += 0.02  # shuts the gate
    in_time, late = arriving(samples, 1)
    known = in_time.copy()
    delayed = DelayedFilter(srukf(gate=0.999), DEPTH)
    for k, (u, y) in enumerate(zip(inputs, in_time, strict=True)):
        change(k, delayed.filter)
        delayed.step(u, y)
        for age, reading in late[k]:
            delayed.insert(age, reading)
            given = ~np.isnan(reading)
            known[k - age, given] = reading[given]
        if k % 15 == 0 or k == 149:
            oracle = srukf(gate=0.999)
            for i in range(k + 1):
                change(i, oracle)
                oracle.step(inputs[i], known[i])
            assert delayed.filter.arena.tobytes() == oracle.arena.tobytes(), k
    assert np.array_equal(known, samples, equal_nan=True)
    health = delayed.filter.health
    assert health.gated > 0 and health.not_finite_input == 2 and health.steps == 150
    assert delayed.delays.inserted == sum(len(readings) for readings in late) > 100
    assert delayed.delays.refused == 0


def test_noise_set_after_the_last_step_stays_for_the_next():
    inputs, samples, _ = healthy_motion(30)
    delayed, oracle = DelayedFilter(srukf(), DEPTH), srukf()
    for k in range(30):
        y = samples[k].copy()
        oracle.step(inputs[k], y)
        if k in (5, 20):
            y[1] = NAN
        delayed.step(inputs[k], y)
        if k in (8, 20):
            for ukf in (delayed.filter, oracle):
                ukf.Q = k * np.diag(PROCESS_STD**2)
            late = np.array([NAN, samples[5 if k == 8 else 20, 1], NAN])
            assert delayed.insert(3 if k == 8 else 0, late) == Status.OK
            assert delayed.filter.arena.tobytes() == oracle.arena.tobytes()
    assert delayed.filter.arena.tobytes() == oracle.arena.tobytes()
    assert delayed.delays == (2, 0, 5)


def test_what_was_set_by_hand_is_marked_word_by_word_but_a_noise_matrix_as_a_whole():
    ukf = srukf()
    start = arena_offsets(4, 3)
    after, marks = ukf.arena.copy(), np.zeros(len(ukf.arena))
    after[start[4]] = ukf.arena[start[4]] = NAN  # a missing innovation is no change
    layout = np.array([len(after), start[2], start[3], start[4], start[9], 3, 3, DEPTH])
    assert _mark(ukf.arena, after, layout, marks) and not marks.any()
    ukf.arena[start[3] + 4] *= 2.0
    assert _mark(ukf.arena, after, layout, marks)
    assert np.flatnonzero(marks).tolist() == list(range(start[3], start[4]))
    longer = np.append(ukf.arena, [1.0, 2.0, 3.0])  # of a filter that keeps something of its own
    own = np.append(ukf.arena, [1.0, 5.0, 3.0])
    assert _mark(longer, own, layout, np.zeros(len(own)))
    marks = np.zeros(len(own))
    _mark(longer, own, layout, marks)
    assert np.flatnonzero(marks).tolist() == [len(after) + 1]
    ukf.arena[start[5]] += 1.0
    assert not _mark(ukf.arena, after, layout, np.zeros(len(after)))


def test_the_status_is_that_of_the_step_it_went_into():
    inputs, samples, _ = healthy_motion(10)
    delayed = DelayedFilter(srukf(gate=0.9999), DEPTH)
    for k in range(10):
        delayed.step(inputs[k], np.full(3, NAN) if k == 6 else samples[k])
    assert delayed.insert(3, [NAN, samples[6, 1], NAN]) == Status.MISSING
    assert delayed.insert(3, [samples[6, 0] + 1.0, NAN, NAN]) == Status.MISSING | Status.GATED
    assert delayed.insert(3, [samples[6, 0], NAN, samples[6, 2]]) == Status.OK  # replaces the wrong position
    oracle = srukf(gate=0.9999)
    oracle.run(inputs, samples)
    assert delayed.filter.arena.tobytes() == oracle.arena.tobytes()


def test_what_cannot_be_used_changes_a_counter_only():
    inputs, samples, _ = healthy_motion(40)
    delayed = DelayedFilter(srukf(), DEPTH)
    late = np.array([NAN, 4.0, NAN])
    assert delayed.insert(0, late) == Status.TOO_OLD  # nothing has happened yet
    for k in range(5):
        delayed.step(inputs[k], samples[k])
    assert delayed.insert(5, late) == Status.TOO_OLD
    for k in range(5, 40):
        delayed.step(inputs[k], samples[k])
    before, ring = delayed.filter.arena.tobytes(), delayed.arena.copy()
    for age in (DEPTH, 10**9, -1):
        assert delayed.insert(age, late) == Status.TOO_OLD
    assert delayed.insert(1, [np.inf, NAN, NAN]) == Status.NOT_FINITE_INPUT
    assert delayed.filter.arena.tobytes() == before
    assert delayed.delays == (0, 6, 0)
    assert np.flatnonzero(~((ring == delayed.arena) | np.isnan(ring))).tolist() == [3]
    assert delayed.insert(DEPTH - 1, late) == Status.OK


def test_an_estimate_set_by_hand_begins_a_new_history():
    inputs, samples, _ = healthy_motion(30)
    delayed, oracle = DelayedFilter(srukf(), DEPTH), srukf()
    late = np.array([NAN, 4.0, NAN])
    for k in range(30):
        if k == 20:
            delayed.filter.reset()
        delayed.step(inputs[k], samples[k])
        if k >= 20:
            oracle.step(inputs[k], samples[k])
    assert delayed.insert(10, late) == Status.TOO_OLD
    assert delayed.filter.arena.tobytes() == oracle.arena.tobytes()
    assert delayed.insert(9, late) == Status.OK
    delayed.filter.reset()
    assert delayed.insert(0, late) == Status.TOO_OLD
    delayed.reset(X0 + 0.1, 4 * P0)
    assert delayed.delays == (0, 0, 0) and delayed.filter.x[0] == X0[0] + 0.1
    delayed.step(inputs[0], samples[0])
    assert delayed.insert(1, late) == Status.TOO_OLD


def test_copies_of_both_arrays_are_a_checkpoint():
    inputs, samples, _ = healthy_motion(40)
    first = DelayedFilter(srukf(), DEPTH)
    for k in range(20):
        first.step(inputs[k], samples[k])
    memory = np.ones(DelayedFilter.arena_size(first.filter, DEPTH) + 2)
    second = DelayedFilter(srukf(), DEPTH, arena=memory[1:-1])
    second.filter.arena[:] = first.filter.arena
    second.arena[:] = first.arena
    for delayed in (first, second):
        delayed.insert(7, [NAN, NAN, 5.0])
        for k in range(20, 40):
            delayed.step(inputs[k], samples[k])
        delayed.insert(3, [NAN, 3.0, NAN])
    assert first.filter.arena.tobytes() == second.filter.arena.tobytes()
    assert first.arena.tobytes() == second.arena.tobytes() and memory[0] == memory[-1] == 1.0


def test_a_model_that_raises_in_the_replay_is_left_to_the_filters_step():
    inputs, samples, _ = healthy_motion(30)
    delayed, oracle = DelayedFilter(srukf(), DEPTH), srukf()
    for k in range(30):
        for ukf in (delayed.filter, oracle):
            change(k + 20, ukf)
        oracle.step(inputs[k], samples[k])
        delayed.step(inputs[k], np.array([NAN, *samples[k, 1:]]) if k == 19 else samples[k])
    replay = delayed._replay

    def raises_half_way(*arguments):
        replay(*arguments[:-1], 4)
        raise ValueError

    delayed._replay = raises_half_way
    assert delayed.insert(10, [samples[19, 0], NAN, NAN]) == Status.OK
    assert delayed.filter.arena.tobytes() == oracle.arena.tobytes()


@pytest.mark.nightly
@pytest.mark.parametrize("adaptation", ["limited", "likelihood"])
def test_an_adaptive_filter_is_replayed_with_all_that_it_keeps(adaptation):
    def adaptive():
        noise = {"Q": np.diag(PROCESS_STD**2), "R": 9 * np.diag(MEASUREMENT_STD**2)}
        return ASRUKF(model(), X0, P0, **noise, adaptation=adaptation, warm_up=20, window=400)

    inputs, samples, _ = healthy_motion(1500)
    in_time, late = arriving(samples, 2)
    known = in_time.copy()
    delayed, oracle = DelayedFilter(adaptive(), DEPTH), adaptive()
    for k in range(1500):
        if k in (700, 900):
            delayed.filter.hold = k == 700
        delayed.step(inputs[k], in_time[k])
        for age, reading in late[k]:
            delayed.insert(age, reading)
            given = ~np.isnan(reading)
            known[k - age, given] = reading[given]
    for k in range(1500):
        if k in (700, 900):
            oracle.hold = k == 700
        oracle.step(inputs[k], known[k])
    assert delayed.filter.arena.tobytes() == oracle.arena.tobytes()
    assert np.abs(np.diag(oracle.R) / MEASUREMENT_STD**2 - 9).max() > 1


def test_refusals_name_argument_value_and_rule():
    ukf = srukf()
    for arguments, words in (
        ((3, 5), "filter = 3: must be a Filter"),
        ((ukf, 0), "depth = 0: must be a whole number of steps >= 1"),
        ((ukf, 2.0), "depth = 2.0"),
        ((ukf, 2, np.zeros(3)), r"arena = float64 \(3,\): must be"),
    ):
        with pytest.raises(ValueError, match=words):
            DelayedFilter(*arguments)
    delayed = DelayedFilter(ukf, 3)
    with pytest.raises(ValueError, match=r"must be \(3,\), \(3,\)"):
        delayed.step(np.zeros(2), np.zeros(3))
    with pytest.raises(ValueError, match=r"y has shape \(2,\): must be \(3,\)"):
        delayed.insert(0, [NAN, NAN])
    assert delayed.insert(0, [NAN, NAN, 1.0]) == Status.TOO_OLD  # the refused step was not remembered

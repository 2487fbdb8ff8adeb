import numpy as np
import pytest

from servohil.estimators import Model
from servohil.estimators.linear_algebra.pseudo_inverse import invert, pseudo_inverse
from servohil.estimators.manifold.luenberger import (
    StructureError,
    check_hidden_decay,
    hidden_errors,
    split_states,
    transform,
)


@pytest.mark.parametrize(
    ("rows", "columns", "rank"), [(1, 2, 1), (2, 1, 1), (3, 3, 3), (2, 4, 2), (5, 3, 2), (3, 3, 1)]
)
def test_pseudo_inverse_is_that_of_numpy(rows, columns, rank):
    rng = np.random.default_rng(rows * 10 + columns)
    for scale in (1e-8, 1.0, 1e9):
        matrix = scale * rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, columns))
        out = np.full((columns + 1, rows), np.nan)
        pseudo_inverse(matrix.copy(), rows, columns, np.zeros((columns, columns)), out)
        wanted = np.linalg.pinv(matrix, rcond=1e-6)
        np.testing.assert_allclose(out[:columns], wanted, atol=1e-11 * np.abs(wanted).max())


def test_pseudo_inverse_takes_the_noise_of_a_difference_for_zero():
    matrix = np.array([[1e-3, 0.0], [2e-3, 1e-11]])
    out = np.zeros((2, 2))
    pseudo_inverse(matrix.copy(), 2, 2, np.zeros((2, 2)), out)
    np.testing.assert_allclose(out, [[200.0, 400.0], [0.0, 0.0]], atol=1e-4)
    pseudo_inverse(np.zeros((2, 2)), 2, 2, np.zeros((2, 2)), out)
    np.testing.assert_array_equal(out, np.zeros((2, 2)))


def test_inverse_of_badly_scaled_rows_and_refusal_of_singular_ones():
    rng = np.random.default_rng(0)
    for size in (1, 2, 5):
        matrix = np.diag(10.0 ** rng.uniform(-12, 12, size=size)) @ rng.normal(size=(size, size))
        out = np.zeros((size, size))
        assert invert(matrix.copy(), size, out)
        np.testing.assert_allclose(out @ matrix, np.eye(size), atol=1e-9)
    out = np.zeros((2, 2))
    for singular in ([[1.0, 2.0], [2.0, 4.0]], [[0.0, 0.0], [1.0, 1.0]], [[np.nan, 1.0], [1.0, 1.0]]):
        assert not invert(np.array(singular), 2, out)


def system():
    """F, H and the hidden states, with noise-free innovation and errors known."""
    rng = np.random.default_rng(8)
    f, c = rng.normal(size=(5, 5)), rng.normal(size=(3, 5))
    return f, c, np.array([4.0, 0.0, 2.0, 1.0, 3.0])


def transformed(f, c, order):
    n, m = 5, 3
    back, phi = np.zeros((n, n)), np.zeros((n, n))
    good = transform(
        order, np.ascontiguousarray(c.T), np.ascontiguousarray(f.T), n, m, np.zeros((m, m)), np.zeros((m, m)), back,
        np.zeros((n, n)), phi,
    )  # fmt: skip
    return good, back, phi


def test_transformation_is_t_f_t_inverse():
    f, c, order = system()
    good, back, phi = transformed(f, c, order)
    t = np.vstack([c, np.eye(5)[[1, 3]]])
    assert good
    np.testing.assert_allclose(back, np.linalg.inv(t), atol=1e-12)
    np.testing.assert_allclose(phi, t @ f @ np.linalg.inv(t), atol=1e-12)
    c[1] = c[0]
    assert not transformed(f, c, order)[0]


@pytest.mark.parametrize(("missing", "unseen"), [((), ()), ((1,), ()), ((), (0,)), ((0,), (2,)), ((0, 1), (2,))])
def test_hidden_errors_from_two_measurements_in_a_row(missing, unseen):
    """Without noise, Phi12 of full column rank: exactly the errors of the estimate, from the rows that count."""
    f, c, order = system()
    _, back, phi = transformed(f, c, order)
    rng = np.random.default_rng(1)
    estimate, truth = rng.normal(size=5), rng.normal(size=5)
    seen = np.ones(3)
    seen[list(unseen)] = 0.0
    estimate_t, truth_t = np.linalg.solve(back, estimate), np.linalg.solve(back, truth)
    for i in unseen:  # nothing is known of its error: here there is none
        truth_t[i] = estimate_t[i]
    truth = back @ truth_t
    last_error = np.where(seen > 0, truth_t[:3] - estimate_t[:3], 0.0)
    innovation = c @ f @ (truth - estimate)
    innovation[list(missing)] = np.nan
    through, before, now = np.full((5, 3), np.nan), np.zeros(2), np.zeros(2)
    known = hidden_errors(
        phi, 5, 3, innovation, last_error, seen, np.zeros((3, 5)), np.zeros((5, 5)), np.zeros((5, 3)), through, before,
        now,
    )  # fmt: skip
    rows = [i for i in range(3) if i not in missing and i not in unseen]
    assert known == bool(rows)
    if len(rows) >= 2:
        np.testing.assert_allclose(before, truth_t[3:] - estimate_t[3:], atol=1e-10)
        np.testing.assert_allclose(now, (f @ (truth - estimate))[[1, 3]], atol=1e-10)
    if rows:
        wanted = np.zeros((2, 3))
        wanted[:, rows] = np.linalg.pinv(phi[:3, 3:][rows])
        np.testing.assert_allclose(through[:2], wanted, atol=1e-10)


def turning(x, u, p, dx):
    dx[0], dx[1], dx[2] = x[1], -x[0] + 0.1 * u[0], -x[2]


def product(x, u, p, y):
    y[0] = x[1] * x[2]


def root(x, u, p, y):
    y[0] = (x[0] - 5.0) ** 0.5 if x[0] > 5.0 else float("nan")


def test_split_takes_the_states_that_the_outputs_determine():
    model = Model(turning, product, 3, 1, [], 0.01)
    split = split_states(model, np.array([1.0, 2.0, 0.5]), np.ones(3))  # slopes 0, 0.5 and 2
    assert list(split.order) == [2, 0, 1]
    split = split_states(model, np.array([1.0, 2.0, 0.5]), np.array([1.0, 10.0, 1.0]))  # in standard deviations
    assert list(split.order) == [1, 0, 2]
    with pytest.raises(StructureError, match="rank 0"):
        split_states(model, np.array([1.0, 0.0, 0.0]), np.ones(3))
    with pytest.raises(StructureError, match="h is not finite"):
        split_states(Model(turning, root, 3, 1, [], 0.01), np.zeros(3), np.ones(3))


def test_hidden_decay_is_that_of_the_simulated_error():
    rng = np.random.default_rng(3)
    for scale in (0.5, 0.9, 1.3, 2.0):
        phi = scale * rng.normal(size=(4, 4)) / 2
        first, second = rng.uniform(0.2, 1.2, size=3), rng.uniform(0.0, 0.3, size=3)
        seen = np.linalg.pinv(phi[:1, 1:]) @ phi[:1, 1:]
        e, before = rng.normal(size=3), np.zeros(3)
        for _ in range(4000):
            e, before = phi[1:, 1:] @ (e - seen @ e) + first * (seen @ e) - second * (seen @ before), e
            size = np.linalg.norm(np.concatenate([e, before]))
            if not 1e-100 < size < 1e100:
                break
        if size > 1e3:
            with pytest.raises(StructureError, match="spectral radius"):
                check_hidden_decay(phi, 1, first, second)
        else:
            assert size < 1e-3
            check_hidden_decay(phi, 1, first, second)

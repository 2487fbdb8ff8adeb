import math
from math import sqrt

import numpy as np
import pytest
from numba import njit
from scipy.special import erf

from servohil.estimators.jets.jet import FUNCTIONS, Jet
from servohil.estimators.jets.on_jets import on_jets

ORDER, N = 6, 2
RADIUS = 0.25
# u(t) = 0.4 + 0.3 t - 0.2 t^2 ..., with a gradient in two start states
U = np.array([[0.4, 1.0, 0.0], [0.3, 0.5, -1.0], [-0.2, 0.0, 2.0], [0.1, -0.3, 0.2], [0.7, 0.1, 0.9], [0.2, 0.6, 0.0]])
W = np.array([[0.9, 0.0, 1.0], [-0.1, 0.2, 0.4], [0.3, 0.7, 0.0], [0.0, 0.1, 0.1], [-0.4, 0.0, 0.3], [0.5, 0.2, 0.8]])


def by_cauchy(function, *jets):
    """Taylor coefficients of function(u(t)), from its values on a circle; gradients by central differences."""
    points = 64
    t = RADIUS * np.exp(2j * np.pi * np.arange(points) / points)

    def coefficients(shift):
        series = [np.polynomial.polynomial.polyval(t, c[:, 0] + c[:, 1:] @ shift) for c in jets]
        return np.fft.fft(function(*series)).real[:ORDER] / points / RADIUS ** np.arange(ORDER)

    columns = [coefficients(np.zeros(N))]
    for i in range(N):
        step = np.zeros(N)
        step[i] = 1e-5
        columns.append((coefficients(step) - coefficients(-step)) / 2e-5)
    return np.column_stack(columns)


def check(function, plain, *jets):
    with np.errstate(all="ignore"):
        np.testing.assert_allclose(function(*(Jet(c) for c in jets)).c, by_cauchy(plain, *jets), rtol=1e-7, atol=2e-8)


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("exp", np.exp), ("expm1", np.expm1), ("log", np.log), ("log2", np.log2), ("log10", np.log10),
        ("log1p", np.log1p), ("sqrt", np.sqrt), ("cbrt", lambda u: u ** (1 / 3)), ("tan", np.tan), ("tanh", np.tanh),
        ("atan", np.arctan), ("asin", np.arcsin), ("acos", np.arccos), ("asinh", np.arcsinh), ("erf", erf),
        ("sin", np.sin), ("cos", np.cos), ("sinh", np.sinh), ("cosh", np.cosh), ("square", lambda u: u * u),
        ("fabs", lambda u: u), ("arctan", np.arctan), ("arcsin", np.arcsin), ("arccos", np.arccos),
    ],
)  # fmt: skip
def test_elementary_functions_against_cauchys_integral(name, plain):
    check(FUNCTIONS[name], plain, U)
    np.testing.assert_array_equal(getattr(Jet(U), name)().c, FUNCTIONS[name](Jet(U)).c)  # as numpy calls it
    assert FUNCTIONS[name](0.4) == pytest.approx(plain(0.4))


def test_arithmetic_against_cauchys_integral():
    check(lambda u, w: u * w + 2.0 * u - w * 3 - (1 - u), lambda u, w: u * w + 2 * u - 3 * w - 1 + u, U, W)
    check(lambda u, w: u / w + 1.0 / u + w / 4.0, lambda u, w: u / w + 1 / u + w / 4, U, W)
    check(lambda u, w: u**3 + w**-2 + u**0.7 + u**w + 2.0**u, lambda u, w: u**3 + w**-2 + u**0.7 + u**w + 2**u, U, W)
    check(lambda u, w: abs(-u) + (+w), lambda u, w: u + w, U, W)
    check(lambda u, w: (u + 7.0) % 2.0 + (w - 1) % 2, lambda u, w: u + 1 + w + 1, U, W)
    check(lambda u: (-1.0 * u) ** 2 * (-u) ** 3, lambda u: -(u**5), U)
    check(FUNCTIONS["hypot"], lambda u, w: np.sqrt(u * u + w * w), U, W)
    check(FUNCTIONS["copysign"], lambda u, w: -u, -U, W)
    check(FUNCTIONS["copysign"], lambda u, w: -u, U, -W)
    for y, x in ((U, W), (W, U), (U, -W), (-W, -U)):  # all branches
        offset = math.atan2(y[0, 0], x[0, 0]) - math.atan(y[0, 0] / x[0, 0])
        check(FUNCTIONS["atan2"], lambda a, b, offset=offset: np.arctan(a / b) + offset, y, x)
    check(FUNCTIONS["atan2"], lambda a, b: np.pi / 2 - np.arctan(b / a), W, U - 0.4 * (np.indices(U.shape).sum(0) == 0))


def test_numbers_of_numpy_and_comparisons():
    u = Jet(U)
    for two in (2, 2.0, np.float64(2.0), np.int64(2)):
        np.testing.assert_array_equal((two * u).c, 2 * U)
        np.testing.assert_array_equal((u * two).c, 2 * U)
        np.testing.assert_allclose((two / u).c, (2.0 / u).c)
        np.testing.assert_allclose((two - u).c, -(u - 2.0).c)
    assert (
        u > 0.3
        and u >= 0.4
        and u < 1
        and not u <= np.float64(0.3)
        and u == 0.4
        and u != 1.0
        and u
        and np.float64(0.3) < u
    )
    assert min(max(u, 0.0), 0.3) == 0.3 and max(u, 0.0) is u
    assert int(u) == 0 and math.floor(u + 1.0) == 1 and math.ceil(u) == 1 and u // 0.25 == 1.0
    assert FUNCTIONS["sign"](-u) == -1.0 and FUNCTIONS["isfinite"](u)
    with pytest.raises(TypeError):
        math.sqrt(u)  # must not quietly drop the derivatives
    with pytest.raises(AttributeError):
        u.bessel()
    with pytest.raises(ZeroDivisionError):
        u / (u - u)


@njit(cache=False)
def signed_root(z):
    return z / sqrt(sqrt(z * z + 1e-3))


@njit(cache=False)
def fills(x, out):
    for i in range(out.shape[0]):
        out[i] = signed_root(x[i])


def make_model(gain):
    def f(x, u, p, dx):
        work = np.zeros(2)
        fills(x, work)
        limited = min(max(x[0], 0.1), p[0])
        dx[0] = gain * work[0] * math.cos(x[1]) + np.sqrt(limited) + np.arctan2(x[0], x[1]) + u[0]
        dx[1] = float(work[1]) * sqrt(abs(x[0])) + (x[1] + math.pi) % (2.0 * math.pi) - math.pi
        dx[2] = np.exp(-x[0]) if x[1] > 0.0 else 0.0

    return f


def test_a_model_function_runs_on_jets_with_its_helpers():
    f, x, u, p = make_model(1.7), np.array([0.6, 0.8]), np.array([0.3]), np.array([0.9])
    jets = np.empty(2, dtype=object)
    jets[:] = [Jet(np.array([[x[i], *np.eye(2)[i]]])) for i in range(2)]
    out = np.empty(3, dtype=object)
    on_jets(njit(f))(jets, u, p, out)
    for i, value in enumerate(np.eye(2) * 1e-6):
        above, below = np.zeros(3), np.zeros(3)
        f(x + value, u, p, above)
        f(x - value, u, p, below)
        np.testing.assert_allclose([jet.c[0, 1 + i] for jet in out], (above - below) / 2e-6, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose([jet.value for jet in out], (above + below) / 2, rtol=1e-10)
    assert f.__globals__["math"] is math  # the original still is what it was

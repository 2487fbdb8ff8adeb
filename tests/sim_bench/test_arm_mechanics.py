"""The papers' arms against their Lagrangians, their energy and their printed matrices."""

from dataclasses import replace

import numpy as np
import pytest
from arms import PLANTS, driver, random_states, rate

from servohil.sim_bench.plants import one_link_arm, pendubot, three_link_arm, two_link_arm
from servohil.sim_bench.plants.one_link_arm import OneLinkArmParameters
from servohil.sim_bench.plants.pendubot import PendubotParameters
from servohil.sim_bench.plants.three_link_arm import ThreeLinkArmParameters
from servohil.sim_bench.plants.two_link_arm import TwoLinkArmParameters

# --- energy -----------------------------------------------------------------------------------------------------------


def two_link_power(x, u, p):
    return u[0] * x[2] + u[1] * x[3], 0.0


def one_link_power(x, u, p):
    coulomb = p.friction_coulomb_nm * np.arctan(p.friction_slope_s_per_rad * x[1])
    return u[0] * x[1], (p.friction_viscous * x[1] + coulomb) * x[1]


def pendubot_power(x, u, p):
    coulomb = p.friction_coulomb_nm * np.arctan(p.friction_slope_s_per_rad * x[1])
    return u[0] * x[1], (p.friction_viscous_1 * x[1] + coulomb) * x[1] + p.friction_viscous_2 * x[3] ** 2


POWERS = {two_link_arm: two_link_power, one_link_arm: one_link_power, pendubot: pendubot_power}


@pytest.mark.parametrize("plant", POWERS, ids=lambda plant: plant.__name__.rpartition(".")[2])
def test_energy_changes_by_the_power_put_in_less_what_friction_takes(plant):
    parameters = PLANTS[plant]()
    p = parameters.vector()
    for x, u in random_states(plant):
        dx = rate(plant, x, u)
        # sixth-order difference of the energy along the flow: exact to about 1e-11 with this step
        t = 5e-3 / np.linalg.norm(dx)
        e = {k: plant.energy(x + k * t * dx, p) for k in (-3, -2, -1, 1, 2, 3)}
        change = (45 * (e[1] - e[-1]) - 9 * (e[2] - e[-2]) + e[3] - e[-3]) / (60 * t)
        put_in, taken = POWERS[plant](x, u, parameters)
        assert taken >= 0.0
        size = np.linalg.norm(u) * np.linalg.norm(x) + taken  # the powers that there are
        assert change == pytest.approx(put_in - taken, abs=1e-9 * size)


# --- Euler-Lagrange, from where the masses are -----------------------------------------------------------------------


def lagrangian(bodies, gravity, q, v):
    """T - V of bodies (mass, inertia, place(q), turn(q)); velocities by complex steps, exact to rounding."""
    ahead = q + 1e-30j * v
    total = 0.0
    for mass, inertia, place, turn in bodies:
        velocity = place(ahead).imag / 1e-30
        total += 0.5 * mass * velocity @ velocity + 0.5 * inertia * (turn(ahead).imag / 1e-30) ** 2
        total -= mass * gravity * place(q).real[1]
    return total


def euler_lagrange(L, q, v, force):
    """The accelerations that fulfil d/dt dL/dv - dL/dq = force; L is quadratic in v, so steps of 1 in v are exact."""
    n = len(q)
    unit = np.eye(n)

    def momentum(at):
        return np.array([0.5 * (L(at, v + unit[i]) - L(at, v - unit[i])) for i in range(n)])

    def slope(g, direction, t=2e-3):
        near, far = (g(q + k * t * direction) - g(q - k * t * direction) for k in (1, 2))
        return (8 * near - far) / (12 * t)

    mass = np.array(
        [[L(q, unit[i] + unit[j]) - L(q, unit[i]) - L(q, unit[j]) + L(q, 0 * v) for j in range(n)] for i in range(n)]
    )
    pull = np.array([slope(lambda at: L(at, v), unit[i]) for i in range(n)])
    return np.linalg.solve(mass, force + pull - slope(momentum, v))


def along(*lengths):
    """Place and direction of a point so far along links whose angles are each taken from the link before."""

    def place(q):
        angles = np.cumsum(q)
        return sum(
            length * np.array([np.cos(angle), np.sin(angle)]) for length, angle in zip(lengths, angles, strict=False)
        )

    return place, lambda q: sum(q[: len(lengths)])


def test_two_link_arm_follows_from_the_places_of_its_masses():
    p = TwoLinkArmParameters(mass_1_kg=0.7, mass_2_kg=1.1, length_1_m=0.9, length_2_m=0.6, gravity_m_per_s2=9.7)
    for parameters in (p, TwoLinkArmParameters()):
        l1, l2 = parameters.length_1_m, parameters.length_2_m
        bodies = [(parameters.mass_1_kg, 0.0, *along(l1)), (parameters.mass_2_kg, 0.0, *along(l1, l2))]
        for x, u in random_states(two_link_arm):
            expected = euler_lagrange(
                lambda q, v, b=bodies, g=parameters.gravity_m_per_s2: lagrangian(b, g, q, v), x[:2], x[2:], u
            )
            np.testing.assert_allclose(rate(two_link_arm, x, u, parameters), [*x[2:], *expected], rtol=1e-6, atol=1e-6)


def test_pendubot_follows_from_the_places_of_its_masses():
    m1, m2, m3, m4, l1, l2, l3, l4, j1, j2, g = 0.6, 0.3, 0.2, 0.15, 0.2, 0.45, 0.22, 0.5, 0.03, 0.006, 9.7
    parameters = PendubotParameters(
        theta_1_kg_m2=m1 * l1**2 + (m2 + m3 + m4) * l2**2 + j1,
        theta_2_kg_m2=m2 * l3**2 + m4 * l4**2 + j2,
        theta_3_kg_m2=(m2 * l3 + m4 * l4) * l2,
        theta_4_kg_m=m1 * l1 + (m2 + m3 + m4) * l2,
        theta_5_kg_m=m2 * l3 + m4 * l4,
        gravity_m_per_s2=g,
    )
    bodies = [(m1, j1, *along(l1)), (m2, j2, *along(l2, l3)), (m3, 0.0, *along(l2)), (m4, 0.0, *along(l2, l4))]
    for x, u in random_states(pendubot):
        q, v = x[[0, 2]], x[[1, 3]]
        coulomb = parameters.friction_coulomb_nm * np.arctan(parameters.friction_slope_s_per_rad * v[0])
        force = [u[0] - parameters.friction_viscous_1 * v[0] - coulomb, -parameters.friction_viscous_2 * v[1]]
        expected = euler_lagrange(lambda q, v: lagrangian(bodies, g, q, v), q, v, np.array(force))
        dx = rate(pendubot, x, u, parameters)
        np.testing.assert_array_equal(dx[[0, 2]], v)
        np.testing.assert_allclose(dx[[1, 3]], expected, rtol=1e-6, atol=1e-6)


def test_one_link_arm_hangs_down_and_swings_as_a_pendulum_does():
    p = OneLinkArmParameters()
    free = replace(p, friction_viscous=0.0, friction_coulomb_nm=0.0)
    assert rate(one_link_arm, [0.0, 0.0], [0.0]).tolist() == [0.0, 0.0]
    stiffness = -rate(one_link_arm, [1e-6, 0.0], [0.0], free)[1] / 1e-6
    assert stiffness == pytest.approx(0.5 * 0.11 * 9.81 / 5.59e-2, rel=1e-9)
    assert rate(one_link_arm, [0.0, 0.0], [1.0])[1] == pytest.approx(1.0 / 5.59e-2, rel=1e-12)


# --- three links: the printed matrices, and what they mean -----------------------------------------------------------


def printed(x, b):
    """D, C and g of P3 eq. 2.4 as they stand there; b[1] .. b[17]."""
    _, t2, t3, w1, w2, w3 = x
    s2, c2, s3, c3 = np.sin(t2), np.cos(t2), np.sin(t3), np.cos(t3)
    d = [
        [b[3] * s2 * c3 + b[6] * c2**2 + b[7] * c3**2 + b[5], 0, 0],
        [0, 0.5 * b[3] * (c2 * c3 + s2 * s3) + b[13], 0.5 * b[3] * (c2 * c3 + s2 * s3) + b[14]],
        [0, 0.5 * b[3] * (c2 * c3 + s2 * s3) + b[17], b[16]],
    ]
    c = [
        [b[1], b[2] * w1 * s2 * c2 + b[3] * w1 * c2 * s3, b[3] * w1 * s2 * c3 + b[4] * w1 * s3 * c3],
        [
            2 * b[11] * w1 * s2 * c2 + 2 * b[12] * w1 * s3 * c3 - 0.5 * b[3] * w1 * (s2 * c3 + c2 * s3),
            0.5 * b[3] * w2 * (c2 * s3 - s2 * c3) + b[10],
            0.5 * b[3] * w3 * (s2 * c3 - c2 * s3),
        ],
        [
            2 * b[12] * w1 * s3 * c3 - 0.5 * b[3] * w1 * s2 * c3,
            0.5 * b[3] * w2 * (c2 * s3 - s2 * c3) - b[15],
            b[15],
        ],
    ]
    return np.array(d), np.array(c), np.array([0.0, b[8] * s2 + b[9] * s3, b[9] * s3])


def test_three_link_arm_is_the_printed_equation():
    parameters = ThreeLinkArmParameters()
    large = replace(parameters, **{f"b{i}": 0.9 * np.sin(i) for i in (2, 4, 8, 9, 11, 12)}, b3=0.05)  # each term shows
    for record in (parameters, large):
        b = np.concatenate([[np.nan], record.vector()])
        for x, u in random_states(three_link_arm):
            d, c, g = printed(x, b)
            expected = np.linalg.solve(d, u - c @ x[3:] - g)
            np.testing.assert_allclose(rate(three_link_arm, x, u, record), [*x[3:], *expected], rtol=1e-10, atol=1e-10)


def test_the_inertia_of_three_links_is_regular_at_every_angle_and_its_least_values_are_found():
    angles = np.linspace(-np.pi, np.pi, 73)
    t2, t3 = (grid.ravel() for grid in np.meshgrid(angles, angles))
    # least D11 at a corner, on the edge sin(th2) = 1, on the edge cos(th3) = 1, inside; least minor at either end
    records = [
        ThreeLinkArmParameters(), ThreeLinkArmParameters(b3=0.05, b6=0.03, b7=0.04),
        ThreeLinkArmParameters(b3=-0.05, b5=0.15, b6=-0.04, b7=-0.03),
        ThreeLinkArmParameters(b3=0.02, b6=-0.03, b7=0.04),
    ]  # fmt: skip
    for record in records:
        b = np.concatenate([[np.nan], record.vector()])
        d = np.array([printed([0, a, c, 0, 0, 0], b)[0] for a, c in zip(t2, t3, strict=True)])
        minor = np.linalg.det(d[:, 1:, 1:])
        assert d[:, 0, 0].min() >= record.least_d11() > 0.0
        assert d[:, 0, 0].min() == pytest.approx(record.least_d11(), abs=1e-4)
        assert minor.min() == pytest.approx(record.least_minor(), rel=1e-9)
        assert minor.min() > 0.0


def power(x, torque):
    """Of three torques on the three links: angles 2 and 3 are both absolute, torque 3 acts between the links."""
    return torque[0] * x[3] + torque[1] * x[4] + torque[2] * (x[5] - x[4])


def test_friction_of_three_links_only_takes():
    """Friction is odd in the speeds, Coriolis and weight are even: half the difference of directions is friction."""
    record = ThreeLinkArmParameters()
    b = np.concatenate([[np.nan], record.vector()])
    for x, u in random_states(three_link_arm):
        back = np.concatenate([x[:3], -x[3:]])
        change = rate(three_link_arm, x, u) - rate(three_link_arm, back, u)
        torque = printed(x, b)[0] @ change[3:] / 2
        taken = -power(x, torque)
        assert taken == pytest.approx(b[1] * x[3] ** 2 + b[10] * x[4] ** 2 + b[15] * (x[5] - x[4]) ** 2, rel=1e-9)
        assert taken > 0.0


def test_with_the_parameters_of_a_mechanism_the_printed_equation_keeps_its_energy():
    """All but s2 c3 for s2 s3 in D11: what the difference does is added here."""
    b3, b6, b7, j2, j3 = 0.04, 0.05, -0.02, 0.2, 0.15
    record = replace(
        ThreeLinkArmParameters(), b1=0.0, b10=0.0, b15=0.0, b2=-2 * b6, b3=b3, b4=-2 * b7, b6=b6, b7=b7, b11=b6 / 2,
        b12=b7 / 2, b13=j2, b14=j3, b16=j3, b17=0.0,
    )  # fmt: skip

    def energy(x):
        s2, c2, s3, c3 = np.sin(x[1]), np.cos(x[1]), np.sin(x[2]), np.cos(x[2])
        turning = 0.5 * (b3 * s2 * s3 + b6 * c2**2 + b7 * c3**2 + record.b5) * x[3] ** 2
        swinging = 0.5 * (j2 * x[4] ** 2 + j3 * x[5] ** 2 + b3 * (c2 * c3 + s2 * s3) * x[4] * x[5])
        return turning + swinging - record.b8 * c2 - record.b9 * c3

    for x, u in random_states(three_link_arm):
        dx = rate(three_link_arm, x, u, record)
        t = 2e-3 / np.linalg.norm(dx)
        near, far = (energy(x + k * t * dx) - energy(x - k * t * dx) for k in (1, 2))
        misprint = b3 * np.sin(x[1]) * (np.sin(x[2]) - np.cos(x[2])) * x[3] * dx[3]
        assert (8 * near - far) / (12 * t) == pytest.approx(power(x, u) + misprint, rel=1e-6, abs=1e-6)


def test_three_links_come_to_rest():
    x = np.array([1, 0.5, 1, 2, -1, -2.0])
    drive = driver(three_link_arm)
    drive(x, np.zeros(3), ThreeLinkArmParameters().vector(), 10.0, 1000)
    assert (np.abs(x[3:]) < 0.02).all()  # what is left is its weight, sinking slowly against friction

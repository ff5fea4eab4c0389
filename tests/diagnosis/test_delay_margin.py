"""How wrong D_hat may be: the crossings in closed form, the spectrum by collocation, and loops that are simulated."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import brentq, fsolve
from scipy.special import lambertw

import npred
from npred.base.errors import ConfigError
from npred.diagnosis.delay_margin import MismatchedLoop
from npred.plants import Plant


class TwoDelays:
    """Two inputs, the second one later; unstable without them."""

    states, inputs, delays = ("x", "y"), ("a", "b"), (0.4, 1.0)
    f = lambda x, u, t, p, M: [0.3 * x.x + x.y + u.a, 0.2 * x.x - 0.1 * x.y + u.b]
    kappa = lambda x, t, p, M: [-2.3 * x.x - 0.4 * x.y, -0.5 * x.x - 2.2 * x.y]


def abscissa(plant: Plant, D: float, D_hat: float, N: int = 40) -> float:
    """The largest real part of the spectrum of (x, U over the delays), by Chebyshev collocation of its generator."""
    n, m, r = plant.n, plant.m, plant.ratios
    closed, B = plant.linearised()
    K = plant.kappa_jacobian(plant.equilibrium)
    A, span = closed - B @ K, max(D, D_hat)
    z = np.cos(np.pi * np.arange(N + 1) / N)
    c = np.array([2.0, *[1.0] * (N - 1), 2.0]) * (-1.0) ** np.arange(N + 1)
    gaps = z[:, None] - z + np.eye(N + 1)
    d = np.outer(c, 1 / c) / gaps
    d = (d - np.diag(d.sum(axis=1))) * 2 / span
    theta = (z - 1) * span / 2  # 0 first, -span last

    def at(times):  # barycentric: values at `times` of the polynomial through the nodes
        away = np.asarray(times)[:, None] - theta
        hit = np.abs(away) < 1e-14
        with np.errstate(divide="ignore", invalid="ignore"):
            w = (1 / c) / away
            w = w / w.sum(axis=1, keepdims=True)
        return np.where(hit.any(axis=1, keepdims=True), hit, w)

    size = n + m * (N + 1)  # x, then the commands of each input at the nodes
    cells = [n + j * (N + 1) + np.arange(N + 1) for j in range(m)]
    P, sigma, law = np.zeros((n, size)), 0.0, np.zeros((m, size))
    P[:, :n] = np.eye(n)
    F, arrived = A.copy(), []
    x, w = np.polynomial.legendre.leggauss(50)
    for j in np.argsort(r):
        h = D_hat * r[j] - sigma
        P = expm(F * h) @ P
        for q, weight in zip(h * (x + 1) / 2, w * h / 2, strict=True):
            for i in set(range(m)) - set(arrived):
                row = at([sigma + q - D_hat * r[i]])[0]
                P[:, cells[i]] += weight * np.outer(expm(F * (h - q)) @ B[:, i], row)
        law[j] = K[j] @ P
        F, sigma = F + np.outer(B[:, j], K[j]), D_hat * r[j]
        arrived.append(j)
    full = np.zeros((size, size))
    full[:n, :n] = A
    for j in range(m):
        full[:n, cells[j]] += np.outer(B[:, j], at([-D * r[j]])[0])
        full[np.ix_(cells[j], cells[j])] = d
    heads = [cell[0] for cell in cells]
    rest = np.setdiff1d(np.arange(size), heads)
    new = np.linalg.solve(np.eye(m) - law[:, heads], law[:, rest])  # U now, by what else is known
    return np.linalg.eigvals(full[np.ix_(rest, rest)] + full[np.ix_(rest, heads)] @ new).real.max()


def test_scalar_plant_crosses_where_its_characteristic_equation_says():
    a, c, D = 0.5, 1.0, 1.0
    low, high = npred.delay_margin(npred.plant("scalar"), D)

    def residual(v):
        s, gain = 1j * v[0], (a + c) * np.exp(a * v[1])
        value = s + c + gain * (np.exp(-s * D) - np.exp(-s * v[1]))
        return [value.real, value.imag]

    for edge, start in ((D + low, 1.3), (D + high, 2.0)):
        roots = [fsolve(residual, [w, edge], full_output=True, xtol=1e-13) for w in np.linspace(0.3, 6, 40)]
        crossings = [abs(v[1] - edge) for v, _, ok, _ in roots if ok == 1 and v[0] > 0.05]
        assert min(crossings) < 1e-7, start


@pytest.mark.parametrize(("name", "D"), [("scalar", 1.0), ("van_der_pol", 1.0), ("chemostat", 1.5), ("pvtol", 0.5)])
def test_the_spectrum_by_collocation_is_on_the_axis_at_both_ends_and_left_between(name, D):
    plant = npred.plant(name)
    low, high = npred.delay_margin(plant, D)
    for edge in (D + low, D + high):
        if 0 < edge < np.inf:
            assert abs(abscissa(plant, D, edge)) < 1e-5
    inside = np.linspace(D + low, D + min(high, 3 * D), 12)[1:-1]
    assert all(abscissa(plant, D, D_hat) < 0 for D_hat in inside)


def test_inputs_with_several_delays_cross_where_the_collocation_does():
    plant = Plant("two", TwoDelays)
    low, high = npred.delay_margin(plant, 1.0)
    assert -1 < low < 0 < high < np.inf
    for edge in (1 + low, 1 + high):
        assert brentq(lambda D_hat: abscissa(plant, 1.0, D_hat), 0.98 * edge, 1.02 * edge) == pytest.approx(
            edge, rel=1e-6
        )


@pytest.mark.parametrize(("name", "D"), [("scalar", 1.0), ("activator_repressor", 1.0), ("strict_feedforward2", 1.0)])
def test_simulated_loops_of_small_states_are_lost_at_the_margin_with_an_error_of_the_order_of_dt(name, D):
    plant = npred.plant(name)
    for edge in npred.delay_margin(plant, D):
        coarse, fine = (_lost(plant, D, edge, D / steps) / edge - 1 for steps in (250, 500))
        assert abs(fine) < 0.005
        assert abs(2 * fine - coarse) < 0.001  # extrapolated to dt = 0


def _lost(plant: Plant, D: float, edge: float, dt: float) -> float:
    """The error of D_hat near `edge` at which loops from near the equilibrium neither grow nor fall."""
    errors, rest = edge * np.linspace(0.98, 1.02, 5), plant.equilibrium
    loop = npred.simulate(
        plant, npred.predictor(plant, "rk4", 201), D=D, D_hat=D + errors, X0=rest + 1e-6 * np.maximum(1, np.abs(rest)),
        t_end=60 * D, dt=dt, u0="equilibrium", actuator="history",
    )  # fmt: skip
    gaps = np.linalg.norm(loop.X - rest, axis=-1)
    middle, end = (
        gaps[:, int(a * gaps.shape[1]) : int(b * gaps.shape[1])].max(axis=1) for a, b in ((0.45, 0.7), (0.75, 1))
    )
    growth = np.log(end / middle)
    assert (np.diff(growth) > 0).all() and growth[0] < 0 < growth[-1]
    return float(np.interp(0.0, growth, errors))


@pytest.mark.parametrize("D_hat", [0.1, 0.8, 1.05, 1.6, 3.0])
def test_stability_by_the_nyquist_curve_is_that_of_the_spectrum(D_hat):
    for plant in (npred.plant("scalar"), npred.plant("van_der_pol"), Plant("two", TwoDelays)):
        assert MismatchedLoop(plant, 1.0).stable(D_hat) == (abscissa(plant, 1.0, D_hat) < 0)


@pytest.mark.parametrize(
    ("name", "parameters", "D", "words"),
    [
        ("scalar", {}, 0.0, "D: expected a time above 0"),
        ("scalar", {"c": -1.0}, 1.0, "expected to stabilise without delay, got the eigenvalue 1"),
        ("transport_tank", {}, 1.0, "expected a constant delay"),
        ("planar_arm2", {}, 1.0, "expected a rest"),
    ],
)
def test_what_has_no_margin_is_refused_in_one_line(name, parameters, D, words):
    with pytest.raises(ConfigError, match=words) as error:
        npred.delay_margin(npred.plant(name, **parameters), D)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("D_hat", [0.1, 0.8, 0.95, 1.02, 1.6, 3.0])
def test_the_rightmost_root_is_that_of_the_spectrum_by_collocation(D_hat):
    for plant in (npred.plant("scalar"), npred.plant("van_der_pol"), npred.plant("pvtol"), Plant("two", TwoDelays)):
        assert MismatchedLoop(plant, 1.0).rightmost(D_hat) == pytest.approx(abscissa(plant, 1.0, D_hat), abs=1e-5)


class DeadTime:
    """A stable plant whose delay may be many of its time constants."""

    states, inputs, guess = ("x",), ("u",), (0.0,)

    @staticmethod
    def f(x, u, t, p, M):
        return [-x.x + u.u]

    @staticmethod
    def kappa(x, t, p, M):
        return [-0.5 * x.x]


@pytest.mark.parametrize("D", [1.0, 5.0, 30.0])
def test_the_rightmost_root_with_a_long_delay(D):
    """Without prediction s + 1 + e^{-sD} / 2 = 0. With a long D_hat roots come near Re s = -1, where e^{-D_hat (1 + s)}
    has the size of 1.
    """
    loop = MismatchedLoop(Plant("dead time", DeadTime), D)
    assert loop.rightmost(0.0) == pytest.approx(lambertw(-0.5 * D * np.exp(D)).real / D - 1, abs=1e-5)
    assert loop.rightmost(60.0 + D) == pytest.approx(-1.0, abs=1 / 60)


def test_the_rightmost_root_where_the_estimate_is_right_is_that_without_delay():
    assert MismatchedLoop(npred.plant("scalar"), 1.0).rightmost(1.0) == -1.0  # c = 1


class Line:
    """x' = a x + u, u = -k x."""

    states, inputs, guess, parameters = ("x",), ("u",), (0.0,), {"a": 0.5, "k": 1.5}
    f = lambda x, u, t, p, M: [p.a * x.x + u.u]
    kappa = lambda x, t, p, M: [-p.k * x.x]


class DoubleIntegrator:
    """With a proportional and derivative law."""

    states, inputs, guess, parameters = ("x", "v"), ("u",), (0.0, 0.0), {"kp": 1.0, "kd": 1.0}
    f = lambda x, u, t, p, M: [x.v, u.u]
    kappa = lambda x, t, p, M: [-p.kp * x.x - p.kd * x.v]


@settings(max_examples=10, deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(0.05, 10.0))
def test_the_longest_delay_of_a_scalar_loop_without_prediction(a, more):
    k = a + more
    longest = npred.delay_margin(Plant("line", Line, {"a": a, "k": k}))
    if k > 1.01 * abs(a):
        assert longest == pytest.approx(np.arccos(a / k) / np.sqrt(k**2 - a**2), rel=1e-7)
    elif k < 0.99 * abs(a):
        assert longest == np.inf


@settings(max_examples=8, deadline=None)
@given(st.floats(0.05, 50.0), st.floats(0.05, 20.0))
def test_the_longest_delay_of_a_double_integrator_is_phase_over_crossover_frequency(kp, kd):
    longest = npred.delay_margin(Plant("double", DoubleIntegrator, {"kp": kp, "kd": kd}))
    omega = np.sqrt((kd**2 + np.sqrt(kd**4 + 4 * kp**2)) / 2)
    assert longest == pytest.approx(np.arctan2(kd * omega, kp) / omega, rel=1e-6)


class Resonant:
    """A mass on a spring with little damping."""

    states, inputs, guess = ("x", "v"), ("u",), (0.0, 0.0)
    f = lambda x, u, t, p, M: [x.v, -25.0 * x.x - 0.2 * x.v + u.u]
    kappa = lambda x, t, p, M: [5.0 * x.x - 2.0 * x.v]


@pytest.mark.parametrize(
    "plant", [*map(npred.plant, ("van_der_pol", "chemostat", "pvtol")), Plant("two", TwoDelays), Plant("r", Resonant)],
    ids=lambda plant: plant.name,
)  # fmt: skip
def test_without_prediction_the_spectrum_by_collocation_reaches_the_axis_at_the_longest_delay(plant):
    longest = npred.delay_margin(plant)
    assert abs(abscissa(plant, longest, 0.0)) < 1e-5
    assert all(abscissa(plant, D, 0.0) < 0 for D in longest * np.linspace(0.05, 0.99, 5))
    assert abscissa(plant, 1.01 * longest, 0.0) > 0


@pytest.mark.parametrize("name", ["van_der_pol", "activator_repressor"])
def test_simulated_loops_without_prediction_are_lost_half_a_control_step_before_the_longest_delay(name):
    """A command that is held acts half a control step late."""
    plant, steps = npred.plant(name), 100
    longest = npred.delay_margin(plant)
    D = longest * np.linspace(0.98, 1.02, 5)
    X0 = plant.equilibrium + 1e-6 * np.maximum(1, np.abs(plant.equilibrium))
    loop = npred.simulate(
        plant, npred.predictor(plant, "rk4", 2), D=D, D_hat=0.0, X0=X0, t_end=60 * longest, dt=longest / steps,
        u0="equilibrium", progress=False,
    )  # fmt: skip
    gaps = np.linalg.norm(loop.X - plant.equilibrium, axis=-1)
    middle, end = (part.max(axis=1) for part in np.array_split(gaps, 4, axis=1)[2:])
    growth = np.log(end / middle)
    assert (np.diff(growth) > 0).all()
    assert np.interp(0.0, growth, D) == pytest.approx(longest * (1 - 0.5 / steps), rel=0.001)


def test_what_has_no_longest_delay_is_refused():
    with pytest.raises(ConfigError, match="expected to stabilise without delay, got the eigenvalue 1"):
        npred.delay_margin(npred.plant("scalar", c=-1.0))
    with pytest.raises(ConfigError, match="expected a constant delay"):
        npred.delay_margin(npred.plant("transport_tank"))


class Stiff:
    """An unstable state, and a fast one behind it that nothing reads."""

    states, inputs, parameters = ("x", "fast"), ("u",), {"rate": 100.0}
    f = lambda x, u, t, p, M: [x.x + u.u, p.rate * (x.x - x.fast)]
    kappa = lambda x, t, p, M: [-2.5 * x.x]


@settings(max_examples=3, deadline=None)
@given(st.floats(2, 7))
def test_a_fast_state_that_nothing_reads_changes_neither_margin_nor_work(exponent: float):
    slow, stiff = Plant("line", Line, {"a": 1.0, "k": 2.5}), Plant("stiff", Stiff, {"rate": 10.0**exponent})
    np.testing.assert_allclose(npred.delay_margin(stiff, 0.3), npred.delay_margin(slow, 0.3), rtol=1e-6)
    assert len(MismatchedLoop(stiff, 0.3).frequencies(0.3, 0.5)) < 200


def test_a_plant_that_grows_by_e_to_the_300_over_its_delay_bears_no_error():
    class Steep:
        states, inputs = ("x", "v"), ("a",)
        f = lambda x, u, t, p, M: [x.v, 1000 * (1 - x.x**2) * x.v - x.x + u.a]
        kappa = lambda x, t, p, M: [-1004 * x.v - 4 * x.x]

    assert npred.delay_margin(Plant("steep", Steep), 0.3) == (0.0, 0.0)

"""Six plants of textbooks, as their users would write them: class, check, loop, C. SciPy referees the loops."""

import shutil
import subprocess
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import npred


class Reactor:
    """A stirred tank reactor at its unstable middle point [Seborg et al., Process Dynamics and Control]."""

    states, inputs = ("c", "T"), ("Tc",)
    units = {"c": "mol/L", "T": "K", "Tc": "K"}
    time_unit = "min"
    box = {"c": (0.4, 0.6), "T": (345.0, 355.0)}
    guess = (0.5, 350.0)
    input_bounds = ((280.0, 320.0),)

    def f(x, u, t, p, M):
        rate = 7.2e10 * M.exp(-8750.0 / x.T) * x.c
        return [1.0 - x.c - rate, 350.0 - x.T + 209.2 * rate + 2.092 * (u.Tc - x.T)]


class BallAndBeam:
    """A ball on a beam, which a slow camera sees."""

    states, inputs = ("r", "v"), ("angle",)
    units = {"r": "m", "v": "m/s", "angle": "rad"}
    box = {"r": (-0.2, 0.2), "v": (-0.1, 0.1)}
    input_bounds = ((-0.3, 0.3),)

    def f(x, u, t, p, M):
        return [x.v, 5 / 7 * 9.81 * M.sin(u.angle)]

    def kappa(x, t, p, M):
        return [-0.3 * x.r - 0.4 * x.v]


class Tanks:
    """Two tanks in a row behind a long pipe."""

    states, inputs = ("h1", "h2"), ("q",)
    units = {"h1": "cm", "h2": "cm", "q": "cm³/s"}
    box = {"h1": (5.0, 25.0), "h2": (5.0, 25.0)}
    guess = (15.0, 15.0)
    input_bounds = ((0.0, 100.0),)

    def f(x, u, t, p, M):
        one, two = (0.3 * M.sqrt(2 * 981 * M.maximum(h, 0.01)) for h in (x.h1, x.h2))
        return [(u.q - one) / 50, (one - two) / 50]


class Glucose:
    """Bergman's minimal model; insulin under the skin acts late."""

    states, inputs = ("G", "X", "I"), ("insulin",)
    units = {"G": "mg/dL", "X": "1/min", "I": "mU/L", "insulin": "mU/min"}
    time_unit = "min"
    box = {"G": (80.0, 180.0), "X": (0.0, 0.02), "I": (5.0, 40.0)}
    guess = (100.0, 0.01, 20.0)
    input_bounds = ((0.0, 200.0),)

    def f(x, u, t, p, M):
        return [2.0 - (0.01 + x.X) * x.G, 1.3e-5 * (x.I - 7.0) - 0.025 * x.X, u.insulin / 12.0 - 0.09 * x.I]


class Furuta:
    """A rotary pendulum, held upright."""

    states, inputs = ("arm", "pole", "arm_rate", "pole_rate"), ("torque",)
    units = {"arm": "rad", "pole": "rad", "torque": "N m"}
    box = {"arm": (-0.5, 0.5), "pole": (-0.1, 0.1), "arm_rate": (-0.5, 0.5), "pole_rate": (-0.5, 0.5)}
    input_bounds = ((-0.2, 0.2),)

    def f(x, u, t, p, M):
        arm, pole, coupling, weight = 4e-3, 1.2e-3, 1.3e-3, 0.085
        s, c = M.sin(x.pole), M.cos(x.pole)
        a, b = arm + pole * s * s, coupling * c
        spin = 2 * pole * s * c * x.arm_rate * x.pole_rate
        one = u.torque - 2e-3 * x.arm_rate - spin + coupling * s * x.pole_rate**2
        two = pole * s * c * x.arm_rate**2 + weight * s - 1e-4 * x.pole_rate
        det = a * pole - b * b
        return [x.arm_rate, x.pole_rate, (pole * one - b * two) / det, (a * two - b * one) / det]


class Servo:
    """A servo with dry friction behind a network."""

    states, inputs = ("angle", "speed"), ("voltage",)
    units = {"angle": "rad", "speed": "rad/s", "voltage": "V"}
    box = {"angle": (-1.0, 1.0), "speed": (-2.0, 2.0)}
    input_bounds = ((-12.0, 12.0),)

    def f(x, u, t, p, M):
        return [x.speed, 8.0 * u.voltage - 5.0 * x.speed - 6.0 * M.tanh(x.speed / 0.05)]

    def kappa(x, t, p, M):
        return [-4.0 * x.angle - 0.5 * x.speed]


class Case(NamedTuple):
    """A plant, its delay, its control step, how long a loop takes, and a law that is designed, if it has none."""

    declared: Any
    D: float
    dt: float
    t_end: float
    kappa: str | None = None

    @property
    def plant(self) -> Any:
        return npred.plant(self.declared, **({"kappa": self.kappa} if self.kappa else {}))

    @property
    def starts(self) -> np.ndarray:
        """The box's corners."""
        ranges = [self.declared.box[name] for name in self.declared.states]
        return np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, len(ranges))


CASES = {
    case.declared.__name__: case
    for case in (
        Case(Reactor, 0.1, 0.002, 10.0, "lqr"),
        Case(BallAndBeam, 0.3, 0.01, 12.0),
        Case(Tanks, 30.0, 1.0, 600.0, "lqr"),
        Case(Glucose, 20.0, 1.0, 1000.0, "lqr"),
        Case(Furuta, 0.02, 0.001, 8.0, "lqr"),
        Case(Servo, 0.15, 0.005, 60.0),
    )
}


@pytest.fixture(params=CASES, scope="module")
def case(request) -> Case:
    return CASES[request.param]


def simulated(case: Case, X0: np.ndarray, D_hat: float, t_end: float) -> Any:
    plant = case.plant
    rk4 = npred.predictor(plant, "rk4", nx=int(case.D / case.dt) + 1)
    parts = {"actuator": "history", "u0": plant.u_equilibrium}
    return npred.simulate(plant, rk4, X0=X0, D=case.D, D_hat=D_hat, t_end=t_end, dt=case.dt, **parts)


def refereed(case: Case, X0: np.ndarray, predicts: bool, t_end: float) -> np.ndarray:
    """X (nt, n) by SciPy's DOP853: the plant over each control step, and P over the commands that are under way."""
    plant, late = case.plant, round(case.D / case.dt)
    under_way, X, rows = [plant.u_equilibrium] * late, np.array(X0), []
    low, high = np.array(case.declared.input_bounds).T

    def onward(X: np.ndarray, U: np.ndarray) -> np.ndarray:
        return solve_ivp(lambda _, x: plant.f(x, U), (0, case.dt), X, "DOP853", rtol=1e-9, atol=1e-9).y[:, -1]

    for _ in range(round(t_end / case.dt) + 1):
        rows.append(X)
        P = X
        for U in under_way if predicts else ():
            P = onward(P, U)
        under_way.append(np.clip(plant.kappa(P), low, high))
        X = onward(X, under_way.pop(0))
    return np.array(rows)


def test_loops_from_the_whole_box_settle(case):
    loops = simulated(case, case.starts, case.D, case.t_end)
    half = np.ptp(np.array([case.declared.box[name] for name in case.declared.states]), axis=1) / 2
    assert (np.abs(loops.X[:, -1] - case.plant.equilibrium) / half).max() < 0.03


def test_a_loop_is_that_of_scipy(case):
    """Two delays from a corner of the box, with prediction and without."""
    t_end = round(2 * case.D / case.dt) * case.dt
    half = np.ptp(np.array([case.declared.box[name] for name in case.declared.states]), axis=1) / 2
    for predicts in (True, False):
        X = simulated(case, case.starts[0], case.D if predicts else 0.0, t_end).X
        assert (np.abs(X - refereed(case, case.starts[0], predicts, t_end)) / half).max() < 1e-3


def test_its_controller_in_c_passes_its_test(case, tmp_path):
    if shutil.which("gcc") is None:
        pytest.skip("no gcc on this machine")
    plant = case.plant
    parts = {"actuator": "history", "u0": plant.u_equilibrium}
    controller = npred.controller(plant, npred.predictor(plant, "rk4", nx=51), None, case.dt, D_hat=case.D, **parts)
    npred.export(controller, "controller", tmp_path)
    command = ["gcc", "-O2", "-DNPRED_TEST", "npred.c", "-lm", "-o", "npred"]
    subprocess.run(command, cwd=tmp_path, check=True)
    assert subprocess.run([tmp_path / "npred"], capture_output=True).returncode == 0

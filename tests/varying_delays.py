"""Loops whose delay varies, by SciPy: equations typed here, which share no code with npred's prediction or loop."""

import numpy as np
from scipy.integrate import solve_ivp

from npred import plants
from npred.plants import Plant


def with_delay(delay):
    """The built-in unicycle, all its commands late by that delay."""
    return Plant("late", type("Late", (plants.resolve("unicycle").declaration,), {"delays": None, "delay": delay}))


TIGHT = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}


class Unicycle:
    """The kinematics and Pomet's law, typed from the literature; D(X, t), and its derivative along a velocity."""

    @staticmethod
    def f(X, u):
        return np.array([u[1] * np.cos(X[2]), u[1] * np.sin(X[2]), u[0]])

    @staticmethod
    def kappa(X, t):
        p, q = X[0] * np.cos(X[2]) + X[1] * np.sin(X[2]), X[0] * np.sin(X[2]) - X[1] * np.cos(X[2])
        omega = -5 * p**2 * np.cos(3 * t) - p * q * (1 + 25 * np.cos(3 * t) ** 2) - X[2]
        return np.array([omega, -p + 5 * q * (np.sin(3 * t) - np.cos(3 * t)) + q * omega])


class InTime(Unicycle):
    """D(t) = (1 + t) / (1 + 2 t); the command of time t acts at sigma(t), in closed form."""

    @staticmethod
    def D(X, t):
        return (1 + t) / (1 + 2 * t)

    @staticmethod
    def rate(X, t, velocity):
        return -1 / (1 + 2 * t) ** 2

    @staticmethod
    def sigma(t):
        return (t + np.sqrt(t**2 + 2 + 2 * t)) / 2


class InSpace(Unicycle):
    """D(X) = x² + y²."""

    @staticmethod
    def D(X, t):
        return X[0] ** 2 + X[1] ** 2

    @staticmethod
    def rate(X, t, velocity):
        return 2 * X[0] * velocity[0] + 2 * X[1] * velocity[1]


def predictor_feedback(robot, X0, times):
    """X at `times` (nt, n) of X' = f(X, U(t - D)), U(t) = kappa(P(t), sigma(t)), the input 0 before t = 0.

    P(t), the prediction of X(sigma(t)), follows P' = sigma' f(P, U), sigma' = 1 / (1 - d/ds D) from X0, where the robot
    rests until its first command; X is the method of steps on it.
    """

    def ahead(t, z):
        P, s = z[:3], z[3]
        velocity = robot.f(P, robot.kappa(P, s))
        return np.array([*velocity, 1.0]) / (1 - robot.rate(P, s, velocity))

    first = arrival(lambda X, t: np.zeros(3), robot.D, X0, 0.0)[0]
    z = solve_ivp(ahead, (0, times[-1]), [*X0, first], dense_output=True, **TIGHT).sol

    def slope(t, X):
        *P, s = z(t - robot.D(X, t))
        return robot.f(X, robot.kappa(np.array(P), s))

    return solve_ivp(slope, (first, times[-1]), X0, t_eval=times, **TIGHT).y.T


def arrival(flow, D, X, t, sent=0.0):
    """The time s with s - D(X(s), s) = sent, along X' = flow(X, t) from X at t, and X(s)."""

    reached = lambda s, x: s - D(x, s) - sent
    reached.terminal, reached.direction = True, 1
    run = solve_ivp(lambda s, x: flow(x, s), (t, t + 10), np.array(X), events=reached, first_step=1e-3, **TIGHT)
    assert run.status == 1
    return run.t[-1], run.y[:, -1]


def delay_free(f, kappa, X, t, times):
    """X' = f(X, kappa(X, t), t) from X at t, at `times`."""
    return solve_ivp(lambda s, x: f(x, kappa(x, s), s), (t, times[-1]), X, t_eval=times, **TIGHT).y.T


def held(f, kappa, D, X, t, dt, times):
    """The same with kappa held from one sigma(k dt) to the next: the loop of an exact prediction and held commands."""
    rows, k = [], 0
    while len(rows) < len(times):
        U, k = kappa(X, t), k + 1
        s, ahead = arrival(lambda x, s, U=U: f(x, U, s), D, X, t, k * dt)
        inside = [time for time in times[len(rows) :] if time <= s]
        if inside:
            rows += [*solve_ivp(lambda s, x, U=U: f(x, U, s), (t, s), X, t_eval=inside, **TIGHT).y.T]
        X, t = ahead, s
    return np.array(rows)

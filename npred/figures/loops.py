"""Fig. 1 of [DAPF]: states, input and delay estimate of one loop with each predictor, and how it ends."""

from functools import partial
from typing import Any

import numpy as np

from npred import lyapunov
from npred.figures.evidence import Evidence, Loop
from npred.figures.plate import Key, Panel, Plate
from npred.figures.style import ROLES, log, look, words

FOCUS = "numerical"  # a loop that is lost may leave the picture, so that the others can be told apart
GOAL = {"color": ROLES["muted"][0], "linewidth": 0.8, "linestyle": (0, (1, 2)), "zorder": 0}
END = 0.1  # the share of the horizon that is looked at closely


def figure1(evidence: Evidence) -> Plate:
    """x, U and D_hat over time [DAPF, Fig. 1], and the states at the end."""
    plant, config = evidence.plant, evidence.config
    names = [*plant.states, *plant.inputs, "delay estimate D̂ (s)"]
    columns = {name: _columns(loop) for name, loop in evidence.loops.items()}
    t = evidence.loops[FOCUS].t
    goals = _goals(evidence, t)
    panels = [
        Panel(name, _told(name, k, columns, t), partial(_over_time, t, columns, k, goals[:, k]))
        for k, name in enumerate(names)
    ]
    panels += [
        Panel(f"{name}, the last tenth", _told_end(name, k, columns), partial(_end, t, columns, k, goals[:, k]))
        for k, name in enumerate(plant.states)
    ]
    where = "rest" if plant.rests else "the reference"
    caption = (
        f"One closed loop from X(0) = {_vector(config.X0)} with D = {config.D:g} s and D̂(0) = {config.D_hat0:g} s, run "
        f"with each predictor. Grey and dotted: {where}, and the true delay."
    )
    return Plate("figure1", "The closed loop", caption, tuple(panels), keys(evidence.loops))


def ends(evidence: Evidence) -> tuple[Panel, ...]:
    """The distance to rest, and W(t) of the stability proof where the update law runs, along the loops of Fig. 1."""
    plant, config = evidence.plant, evidence.config
    distance = {name: np.linalg.norm(loop.X - plant.target(loop.t), axis=1) for name, loop in evidence.loops.items()}
    W = {name: _W(evidence, loop) for name, loop in evidence.loops.items() if np.isfinite(loop.N).any()}
    t = evidence.loops[FOCUS].t
    last = "; ".join(f"{words(name)} {values[-1]:.1e}" for name, values in distance.items())
    falls = "; ".join(f"{words(name)} from {values[0]:.3g} to {values[-1]:.3g}" for name, values in W.items())
    told = f"D log N + (b / γ) (D − D̂)², with b = {config.b:g}, γ = {config.gamma:g}: {falls}."
    return (
        Panel("distance |X − X*|", f"Over {t[-1]:g} s on a logarithmic scale; at the end: {last}.",
              partial(_curves, t, distance)),
        *([Panel("W(t) of the proof", told, partial(_curves, t, W))] if W else []),
    )  # fmt: skip


def keys(names: Any) -> tuple[Key, ...]:
    """Legend entries of these contenders."""
    return tuple(Key(words(name), look(name)) for name in names)


def _columns(loop: Loop) -> np.ndarray:
    return np.concatenate([loop.X, loop.U, loop.D_hat[:, None]], axis=1)


def _goals(evidence: Evidence, t: np.ndarray) -> np.ndarray:
    """Where states and inputs are to go, the input leading by D, and the true delay, (nt, n + m + 1)."""
    plant, D = evidence.plant, np.full((len(t), 1), evidence.config.D)
    X, u = (
        np.broadcast_to(goal, (len(t), goal.shape[-1]))
        for goal in (plant.target(t), plant.u_target(t + evidence.config.D))
    )
    return np.concatenate([X, u, D], axis=1)


def _over_time(t: np.ndarray, columns: dict[str, np.ndarray], k: int, goal: np.ndarray, axis: Any) -> None:
    for name, found in columns.items():
        axis.plot(t, found[:, k], **look(name).line)
    axis.plot(t, goal, **GOAL)
    axis.set_ylim(*_around(columns[FOCUS][:, k]))
    axis.set(xlabel="t (s)", xlim=(t[0], t[-1]))


def _end(t: np.ndarray, columns: dict[str, np.ndarray], k: int, goal: np.ndarray, axis: Any) -> None:
    """The last tenth, at least a part in a thousand of the value high: closer, lines are one line."""
    late = t >= min((1 - END) * t[-1], t[-2:][0])  # a line has two ends
    shown = {name: found[late, k] for name, found in columns.items() if name != "no_adaptation"}
    for name, found in shown.items():
        axis.plot(t[late], found, **look(name).line)
    axis.plot(t[late], goal[late], **GOAL)
    gaps = [gap for found in shown.values() if np.isfinite(gap := float(np.abs(found - goal[late]).max()))]
    reach = max([1.5 * gap for gap in gaps] + [1e-3 * float(np.abs(goal).max()), 1e-9])
    axis.set(xlabel="t (s)", xlim=(t[late][0], t[-1]), ylim=(goal[late].min() - reach, goal[late].max() + reach))
    axis.ticklabel_format(axis="y", useOffset=False)


def _curves(t: np.ndarray, curves: dict[str, np.ndarray], axis: Any) -> None:
    for name, values in curves.items():
        positive = np.where(np.isfinite(values) & (values > 0), values, np.nan)
        axis.plot(t, positive, **look(name).line)
    axis.set(xlabel="t (s)", xlim=(t[0], t[-1]))
    log(axis, "y")


def _W(evidence: Evidence, loop: Loop) -> np.ndarray:
    config = evidence.config
    return lyapunov.W(loop.N, config.D, loop.D_hat, config.gamma, config.b)


def _around(values: np.ndarray) -> tuple[float, float]:
    """The range of the values with room on both sides."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    room = 0.15 * (high - low) or 1.0
    return low - room, high + room


def _told(name: str, k: int, columns: dict[str, np.ndarray], t: np.ndarray) -> str:
    found = "; ".join(f"{words(c)} {values[0, k]:.4g} to {values[-1, k]:.4g}" for c, values in columns.items())
    return f"{name} from 0 to {t[-1]:g} s: {found}."


def _told_end(name: str, k: int, columns: dict[str, np.ndarray]) -> str:
    found = "; ".join(f"{words(c)} {values[-1, k]:.6g}" for c, values in columns.items())
    return f"{name} over the last tenth of the horizon, ending at: {found}."


def _vector(values: Any) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"

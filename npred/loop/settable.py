"""Which parameters a controller can be set to while it runs, and a course of such set-points in a simulated loop."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from npred import plants
from npred.base import array_checks
from npred.base.errors import ConfigError, unlisted
from npred.formulas import programs
from npred.formulas.trace import Trace
from npred.plants import setpoint
from npred.plants.base import Plant
from npred.prediction.methods import Predictor

SAME = 1e-9  # of a time: those this close are one


class Piece(NamedTuple):
    """From a time on: the numbers that the controller reads as p, and those of its set-points that were set so far."""

    start: float
    p: np.ndarray
    values: Mapping[str, float]

    def target(self, plant: Plant, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """X* and U* at times t (T,), (T, n) and (T, m); NaN where kappa leads to no rest."""
        n, m = plant.n, plant.m
        if plant.declares_setpoint:
            X, U = self.p[-n - m : -m], self.p[-m:]
        else:
            try:
                of = plants.varied(plant, tuple(self.values.items())) if self.values else plant
                X, U = of.target(t), of.u_target(t)
            except ConfigError:
                X, U = np.full(n, np.nan), np.full(m, np.nan)
        return np.broadcast_to(X, (len(t), n)), np.broadcast_to(U, (len(t), m))


def course(
    plant: Plant, setpoints: Mapping[str, Any], cannot: Mapping[str, str] = {}, bounds: np.ndarray | None = None
) -> list[Piece]:
    """The pieces of set-points {name: (times, values)}, the first one as declared, from minus infinity on.

    Raises ConfigError for an unknown parameter, one that cannot be set, and for times or values that do not fit.
    """
    changes: dict[float, dict[str, float]] = {}
    for name, pair in setpoints.items():
        if name not in plant.parameters:
            free = [other for other in plant.parameters if other not in cannot]
            raise ConfigError(unlisted("setpoints", name, free, "a parameter,"))
        try:
            times, values = (array_checks.floats(f"setpoints: {name}", part) for part in pair)
            fits = times.ndim == 1 and times.shape == values.shape and (np.diff(times) > 0).all()
        except (TypeError, ValueError):
            fits = False
        if not fits or not (np.isfinite(times).all() and np.isfinite(values).all()):
            what = "expected (times, values), as many of both, the times rising"
            raise ConfigError(f"setpoints: {name}: {what}, got {pair!r}; write ([0.0, 5.0], [1.0, 2.0]), say")
        for time, value in zip(times.tolist(), values.tolist(), strict=True):
            changes.setdefault(time, {})[name] = value
    free = np.tile([-np.inf, np.inf], (plant.m, 1))
    limits = setpoint.bounds(plant, free if bounds is None else bounds) if plant.declares_setpoint else free
    pieces = [Piece(-math.inf, plant.p, {})]
    for time, values in sorted(changes.items()):
        p = setpoint.changed(plant, pieces[-1].p, values, cannot, limits)
        pieces.append(Piece(time, p, {**pieces[-1].values, **values}))
    return pieces


def targets(plant: Plant, pieces: list[Piece], t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """X* (T, n) and U* (T, m) of the set-points of the times t (T,), rising."""
    starts = np.searchsorted(t, [piece.start * (1 - SAME) for piece in pieces])
    rows = zip(pieces, np.split(t, starts[1:]), strict=True)
    X, U = zip(*(piece.target(plant, part) for piece, part in rows), strict=True)
    return np.concatenate(X), np.concatenate(U)


def fixed(plant: Plant, predictor: Predictor) -> dict[str, str]:
    """Why a parameter cannot be set, by its name; those that are not here can be.

    A network was trained for what the prediction reads, and the gains of a law of npred.laws are those of one f.
    """
    if not plant.traced:
        return dict.fromkeys(plant.parameters, "the functions of a plant with traced = False are called as they are")
    declared = {"delay": plant.declares_delay, "output": plant.declares_output, "safe": plant.declares_safe}
    others = [name for name, has in (declared | {"reference": plant.tracks}).items() if has]
    in_f, in_any = _read(plant, "f"), _read(plant, "f", "kappa", "V", *others)
    predicted = ["f", *(["delay"] if plant.declares_delay else []), *([] if plant.one_delay else ["kappa"])]
    trained = _read(plant, *predicted) if hasattr(getattr(predictor, "model", predictor), "operator") else set()
    designed = in_f if hasattr(plant.law, "guess") else set()
    reasons = {
        name: "the network was trained with it" if name in trained else "the law was designed with it"
        for name in (*trained, *designed)
    }
    return {name: "nothing reads it" for name in plant.parameters if name not in in_any} | reasons


def _read(plant: Plant, *functions: str) -> set[str]:
    """The parameters that functions read, by themselves or by the rest that follows from them."""
    trace = Trace(plant)
    x, u, t = trace.symbols()
    outputs: list[object] = []
    for name in functions:
        arguments = {"f": (x, u, t), "reference": (t,)}.get(name, (x, t))
        outputs += [*np.ravel(np.array(getattr(trace, name)(*arguments), dtype=object))]
    symbols = zip(plant.p_names, trace.parameters, strict=True)
    names = {name for name, symbol in symbols if programs.depends(outputs, [symbol])}
    if not names <= plant.parameters.keys():
        names |= _read(plant, "f", "setpoint")
    return names & plant.parameters.keys()

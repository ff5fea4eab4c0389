"""Closed loops of plant, actuator, predictor and delay adaptation, simulated side by side [DAPF, eqs. 6-14]."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
from numpy.typing import ArrayLike

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.base.progress import announce, counted, quiet, say
from npred.estimation.delay_law import Adaptation, DelayLaw
from npred.loop import acts, clocked, engine, loop_checks, settable, trajectory_views
from npred.loop.loop import Loop, LoopParts
from npred.loop.simulation import Simulation
from npred.loop.trajectories import Samples, Trajectories, of_record
from npred.plants import inputs
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods import Predictor

__all__ = ["Samples", "Trajectories", "simulate"]


def simulate(
    plant: Plant, predictor: Predictor | None, *, X0: Any, t_end: float, D: Any = None, D_hat: Any = None,
    dt: float | None = None, adaptation: DelayLaw | Adaptation | str | None = None, every: int = 1,
    samples: ArrayLike | None = None, progress: Callable[[int], Any] | bool | None = None, **parts: Unpack[LoopParts],
) -> Trajectories:  # fmt: skip
    """Loops of X' = f(X, U(t - D)), U = kappa(P(1)), D_hat' = gamma Proj{D_hat, phi} [DAPF, eqs. 6-14].

    D, D_hat and X0 broadcast to the batch. Where inputs have several delays input j comes after r_j D, and U_j =
    kappa_j(P(r_j), t + r_j D_hat). A DelayLaw that you write runs in Python. If a loop overflows, the rest of it is
    NaN; the other loops are not affected. Where commands would overtake each other, a loop of a plant that declares its
    delay is marked (`infeasible`) and ends.

    `setpoints`, {"aim": ([10.0, 20.0], [1.0, 2.0])} say, are parameters that are set while the loop runs, as
    `controller.set` does it and at the same moment in the simulated plant, where it has them. kappa does not know them
    beforehand. N and energy are those of the set-point of the time.

    Without a predictor the loop is open, U = 0. With D_hat = 0 there is no prediction, U = kappa(X, t). A plant that
    declares its delay takes no other D_hat.

    With `timing`, `observer` or `watchdog` the loops run on a real clock, one after the other: npred.controller with
    actuator="history" is called at its own times, and samples and commands have theirs, not rounded to control steps. X
    is that of k dt all the same; `clock` has what the controller says besides (npred.loop.trajectories.OnAClock).

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    predictor : Predictor or None
        From npred.predictor, npred.load or npred.guarded; None is the open loop U = 0.
    X0 : array (..., n), in the plant's units
        States at t = 0.
    t_end : float, in the plant's unit of time
        Length of the loops.
    D : array (...) or function of t, in the plant's unit of time, optional
        True delay, where inputs have several the longest. A function is a delay that drifts or jumps. None for a
        plant that declares its delay.
    D_hat : array (...), in the plant's unit of time, optional
        Estimate of the delay; None for a plant that declares it.
    dt : float, in the plant's unit of time, optional
        Control step; U is held over it. By default npred.loop.control_step.usual of the delay, the plant and the law:
        with a delay of 1 it is 0.01 for `scalar`, 0.005 for the paper's plant, and for `scalar` with a law that
        integrates a rate of D_hat, as DelayAdaptation.
    adaptation : DelayLaw, its name as "delay-observer", or None, optional
        Law of the estimate D_hat; None or "frozen" freezes it, as for a plant that declares its delay and without a
        predictor.
    every : int, default 1
        Control steps between two kept states.
    samples : int array (..., S), optional
        Control steps, sorted, of which (X, u, D_hat) are kept too.
    progress : bool or function, optional
        True shows a bar, in a terminal or a notebook; a function gets the number of loop steps done; by default a
        line on stderr says so if loops take longer than a second.
    **parts
        The other parts of npred.Loop: input_bounds, u0, actuator, measurement, truth, disturbance, setpoints,
        safety, integrator, timing, observer, watchdog, outlier_limit, max_sample_age. What it needs is said there.

    Returns
    -------
    Trajectories
        Closed loops: t (nt,), X and P (..., nt, n), U (..., nt, m), D_hat, N and energy (..., nt).

    Raises
    ------
    ConfigError
        For parts that do not fit, or that are unknown, or without what they need.
    """
    named = {"plant": plant, "predictor": predictor, "D": D, "D_hat": D_hat, "X0": X0, "dt": dt}
    loop = Loop.of("simulate", (), named | {"adaptation": adaptation, **parts})
    loops = run(loop, t_end, every, samples, progress)
    if progress is not False and (words := trajectory_views.at_bound(loops)):
        say(f"simulate: {words}")
    return loops


def run(
    loop: Loop, t_end: float, every: int = 1, samples: ArrayLike | None = None,
    progress: Callable[[int], Any] | bool | None = None,
) -> Trajectories:  # fmt: skip
    """Simulate a loop over t_end; see `simulate`."""
    plant, law = loop.plant, loop.adaptation
    X0 = array_checks.floats("X0", loop.X0)
    loop_checks.start(plant, X0)
    D, D_hat, table = loop.D, loop.D_hat, None
    if plant.declares_delay:
        D, D_hat = _declared(loop.real, X0), D_hat if loop.blind else _declared(plant, X0)
    first = D(0.0) if callable(D) else D
    loop = loop_checks.stepped(loop, first, D_hat, t_end)
    dt = loop.dt
    loop_checks.times(loop, t_end, every)
    loop_checks.record(plant, 1, t_end, dt, every)  # before a function of t is asked for each step
    if callable(D):
        table = _tabulated(D, t_end, dt)
        D = table[0]
    D, D_hat = array_checks.floats("D", D), array_checks.floats("D_hat", D_hat)
    array_checks.delays("D", D)
    array_checks.delays("D_hat", D_hat)
    loop_checks.one_per_loop(plant, D, X0)
    if law is not None:
        law = law.suited(plant, D if table is None else table, D_hat)
        array_checks.within("D_hat", D_hat, law.bounds, plant.time_unit)
    shape = array_checks.batch(X0=X0.shape[:-1], D=D.shape, D_hat=D_hat.shape)
    if 0 in shape:
        raise ConfigError(f"X0, D, D_hat: expected at least one loop, got a batch of shape {shape}; give one a start")
    X0 = np.broadcast_to(X0, (*shape, plant.n)).reshape(-1, plant.n)
    D, D_hat = (np.broadcast_to(a, shape).reshape(-1) for a in (D, D_hat))
    loop_checks.delays(loop, D, D_hat, t_end)
    delays = np.zeros((0, len(D)))
    if table is not None:
        padded = table.reshape(len(table), *(1,) * (len(shape) - table.ndim + 1), *table.shape[1:])
        delays = np.broadcast_to(padded, (len(table), *shape)).reshape(-1, len(D))
    loop_checks.record(plant, len(D), t_end, dt, every)
    steps = loop_checks.samples(samples, shape, round(t_end / dt))
    method, limits = acts.integrator(loop.integrator, plant, loop.real), inputs.bounds(plant, loop.input_bounds)
    past = inputs.past(plant, loop.u0, limits, X0, D)
    first_D_hat = D_hat if loop.blind or not plant.declares_delay else None
    complete = loop.filled(D=D, D_hat=first_D_hat, X0=X0, adaptation=law, input_bounds=limits)
    one = Simulation(complete, round(t_end / dt) + 1, every, method, shape, D_hat, past, steps, delays)
    loop_checks.history(plant, one.reach(slice(None))[1], dt)
    with quiet() if progress is False else nullcontext():
        engine.prepare(one.parts)
    with _counted(progress, len(D), one.count) as count:
        record, clock = clocked.run(one, count) if loop.on_a_clock else (one.run(count), None)
    ends = law.ends(dt) if law and loop.predictor else None
    run = of_record(record, shape, dt * every, one.count, plant, loop.real, loop.predictor, ends, clock)
    if not loop.setpoints:
        return run
    X, U = settable.targets(plant, one.course, run.t)
    return replace(run, target=X, u_target=U)


def _declared(plant: Plant, X0: np.ndarray) -> np.ndarray:
    """D(X0, 0), (...)."""
    X = np.array(X0.reshape(-1, plant.n).T, order="C")
    D_hat, D = np.empty(X.shape[1]), np.empty((plant.m, X.shape[1]))
    horizon = problem_of(plant).horizon()
    assert horizon is not None
    horizon(X, 0.0, plant.p, plant.ratios, D_hat, D)
    return D_hat.reshape(X0.shape[:-1])


def _tabulated(D: Callable[[float], Any], t_end: float, dt: float) -> np.ndarray:
    """D(t) at the control steps and one further, (steps + 1, ...)."""
    values = [array_checks.floats("D(t)", D(k * dt)) for k in range(round(t_end / dt) + 2)]
    array_checks.batch(**{f"D({k * dt:g})": value.shape for k, value in enumerate(values)})
    table = np.stack(np.broadcast_arrays(*values))
    array_checks.delays("D(t)", table)
    return table


@contextmanager
def _counted(
    progress: Callable[[int], Any] | bool | None, loops: int, steps: int
) -> Iterator[Callable[[int], Any] | None]:
    """A function of the number of loop steps done: a bar where `progress` is True, a line where it is not said."""
    if progress is None:
        with announce(f"simulating {counted(loops, 'loops')}", total=loops * steps) as work:
            yield work.advance
    elif progress is True:
        from tqdm.auto import tqdm

        with tqdm(total=loops * steps, unit="step", unit_scale=True) as bar:
            yield bar.update
    else:
        yield progress or None

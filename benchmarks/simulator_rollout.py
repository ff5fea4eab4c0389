"""A network beside the plant's own simulator rolled forward, at equal tracking error in the closed loop.

python benchmarks/simulator_rollout.py pipeline/mujoco_arm.toml:deeponet

Loops of the arm from fresh starts of its box, with the exact prediction (RK4 on the nodes of the data), the network,
and MuJoCo's own rollout by two of its integrators, on the file's time step and on the fewest steps with which the
tracking error is within 10 %, and within 1 %, of the network's. It is the root mean square of |q - r| (rad, over the
joints) in the second half of each loop; the table has the median over the loops. The time of a rollout is that of its
steps in one call of mj_step, without Python in between: less than mujoco.rollout takes, which is in brackets. A step of
the exact prediction calls mj_forward four times, as one of MuJoCo's RK4 does: it is charged for the same time. Extra:
npred[mujoco].
"""

from bisect import bisect_left
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import harness
import mujoco
import numpy as np

import npred
from npred import plants
from npred.base import randomness
from npred.lab import config
from npred.lab.stages.bench import timing
from npred.loop import metrics
from npred.plants import Plant
from npred.prediction.methods import Predictor
from npred.prediction.methods.rollout import Rollout
from npred_robots.mjcf import LEFT_OUT

STARTS = 12
WITHIN = (0.1, 0.01)  # of the network's tracking error
FILE = Path("pipeline/mujoco_arm.xml")
Tracking = tuple[int, float]  # the loops that are kept, and the median tracking error


class Rival(NamedTuple):
    """An integrator of MuJoCo, the most steps that are tried, and the plant that it rolls forward."""

    title: str
    integrator: str  # as MuJoCo spells it
    most: int
    arm: Plant


def main() -> None:
    arguments = harness.options(__doc__, {"model": ...}, store=str)
    pipeline = harness.pipeline(arguments.model)
    arm, by_rk4 = (
        plants.resolve(f"{pipeline.plant.rpartition(':')[0]}:{name}", pipeline.parameters)
        for name in ("Arm", "ArmByRK4")
    )
    table, X0 = pipeline.evaluate, harness.starts(arm, STARTS, randomness.generator(1, "simulator_rollout"))
    network = harness.network(arguments, table.nx)
    exact, allowed = (tracking(arm, run, X0, table) for run in (npred.predictor(arm, "rk4", table.nx), network))
    network_us = call_us(network, X0[0], arm.u_target(0.0), table.D)
    print(f"D = {table.D:g} s, {STARTS} loops of {table.case_t_end:g} s: those kept, tracking error, µs per prediction")
    print(row("RK4, exact", exact), f"{(table.nx - 1) * engine_us('RK4', table.D):.0f}")
    print(row("network, fused", allowed), f"{network_us:.1f}", flush=True)
    if allowed[0] < STARTS:
        raise SystemExit("The network loses loops: there is no equal tracking error to compare at.")
    for rival in (Rival("implicitfast", "IMPLICITFAST", 500, arm), Rival("RK4", "RK4", 100, by_rk4)):
        compare(rival, arm, X0, table, allowed[1], network_us)


def compare(rival: Rival, arm: Plant, X0: np.ndarray, table: Any, allowed: float, network_us: float) -> None:
    """Print the rows of a rival."""
    step_us, tracked = engine_us(rival.integrator, table.D), {}

    def enough(steps: int, share: float) -> bool:
        if steps not in tracked:
            tracked[steps] = tracking(arm, Rollout(rival.arm, steps + 1), X0, table)
        return tracked[steps][0] == STARTS and tracked[steps][1] <= (1 + share) * allowed

    fewest = {
        bisect_left(range(rival.most), True, lo=2, key=partial(enough, share=share)): share
        for share in WITHIN
        if enough(rival.most, share)
    }
    if rival.integrator == "IMPLICITFAST":
        enough(files_steps(table.D), 0.0)
    for steps in sorted(tracked):
        by_call = call_us(Rollout(rival.arm, steps + 1), X0[0], arm.u_target(0.0), table.D)
        times = f"{steps * step_us:.0f}, {steps * step_us / network_us:.0f} x the network's"
        times += f" ({by_call:.0f} by mujoco.rollout)"
        times += f": within {fewest[steps]:.0%}" if steps in fewest else ""
        print(row(f"{rival.title}, {steps} steps", tracked[steps]), times, flush=True)


def tracking(arm: Plant, predictor: Predictor, X0: np.ndarray, table: config.Evaluate) -> Tracking:
    """Loops from X0 (STARTS, n). A loop is kept where it ends near the reference, a lost one has an infinite error."""
    loops = npred.simulate(
        arm, predictor, D=table.D, D_hat=table.D, X0=X0, t_end=table.case_t_end, dt=table.dt, u0=table.u0
    )
    target, later, joints = arm.target(loops.t), loops.t > loops.t[-1] / 2, arm.n // 2
    kept = metrics.radius(loops, target) <= metrics.SETTLED * metrics.size(target)
    gaps = np.linalg.norm((loops.X - target)[:, later, :joints], axis=-1)
    return int(kept.sum()), float(np.median(np.nan_to_num(np.sqrt((gaps**2).mean(axis=1)), nan=np.inf)))


def files_steps(D: float) -> int:
    """The steps of the file's own time step in D seconds."""
    return round(D / mujoco.MjModel.from_xml_path(str(FILE)).opt.timestep)


def engine_us(integrator: str, D: float, steps: int = 100) -> float:
    """Microseconds of a step of the engine, of many in one call of C."""
    model = mujoco.MjModel.from_xml_path(str(FILE))
    for part in LEFT_OUT:
        model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{part}").value
    model.opt.integrator, model.opt.timestep = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}"), 0.002
    data = mujoco.MjData(model)
    taken = timing.sample({"steps": lambda k: mujoco.mj_step(model, data, steps)}, 1000, 0.3)
    return timing.quantiles(taken["steps"])["median_us"] / steps


def call_us(predictor: Predictor, X: np.ndarray, u: np.ndarray, D: float) -> float:
    """The median microseconds of a call, as a loop makes it."""
    predict, plant = predictor.lanes(), predictor.plant
    inputs = X[:, None].copy(), np.tile(u[None, :, None], (predictor.nx, 1, 1)), np.array([D])
    P = np.empty((predictor.nx, plant.n, 1))
    taken = timing.sample({"call": lambda k: predict(*inputs, 0.0, plant.p, P)}, 2000, 0.3)
    return timing.quantiles(taken["call"])["median_us"]


def row(title: str, tracked: Tracking) -> str:
    return f"{title:28} {tracked[0]:2} of {STARTS}  {tracked[1]:.3e} "


if __name__ == "__main__":
    main()

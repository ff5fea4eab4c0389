"""A plant with one lag and a delay: PI, Smith predictor and npred's predictor, all tuned; figures of docs/pi.md.

    python benchmarks/pi.py [steps] [errors] [integral]

T x' = -x + K u(t - D), T = 1, K = 1, D / T = 0.2, 1 and 4.

steps: IAE of a step of the load, and of the set-point, by 0.4. Gains are those with the least IAE, the worst of true
delays of 0.9 D, D and 1.1 D: k and T_i of the rivals, of the predictor R of kappa = "lqr" and the EKF's offset.
errors: where the output ends with a load and a gain that the model does not know, with and without an offset.
integral: the overshoot of an integral of the error that is a state of the plant.
"""

from dataclasses import replace

import harness
from plants import Integral, Lag

import npred
from npred.diagnosis import pi
from npred.diagnosis.case import Case

STEP, RATIOS, WEIGHTS = 0.4, (0.2, 1.0, 4.0), (1.0, 0.3, 0.1, 0.03, 0.01)


def plant(R: float) -> npred.plants.Plant:
    return npred.plant(Lag, kappa={"law": "lqr", "R": [[R]]})


def steps() -> None:
    print("D / T  step of    PI: IAE (k, T_i)      Smith: IAE (k, T_i)   predictor: IAE (R, offset)")
    for D in RATIOS:
        for of in ("load", "set-point"):
            task = pi.task_of(Case(plant(1.0), D, 101, 256))
            assert task is not None
            sizes = {"push": STEP, "step": 0.0} if of == "load" else {"push": 0.0, "step": STEP, "aim": "aim"}
            task, found = replace(task, **sizes), []
            PI, smith = (pi.tuned(task, way) for way in (False, True))
            for R in WEIGHTS:
                one = plant(R)
                iae, offset = pi.predicted(replace(task, plant=one), Case(one, D, 101, 256))
                found.append((iae, R, offset))
            iae, R, offset = min(found)
            rivals = "  ".join(f"{one.iae:7.3f} ({one.k:.2g}, {one.T_i:.2g})".ljust(22) for one in (PI, smith))
            print(f"{D:5g}  {of:9}  {rivals}{iae:7.3f} ({R:g}, {offset:.2g})", flush=True)


def errors() -> None:
    one = plant(0.1)
    for D in RATIOS:
        for what, K, push in (("load", 1.0, STEP), ("gain 20 % higher", 1.2, 0.0), ("gain 20 % lower", 0.8, 0.0)):
            ends = []
            for offset in (False, True):
                run = npred.simulate(
                    one, npred.predictor(one, "rk4"), D=D, D_hat=D, X0=[1.0], t_end=30.0 * (1 + D), actuator="history",
                    u0="equilibrium", truth=npred.plant(Lag, K=K, kappa="lqr"),
                    disturbance=lambda t, push=push: [push], observer=npred.observers.EKF(one, offset=offset),
                )  # fmt: skip
                ends.append(run.X[-1, 0] - 1.0)
            off = f"the output ends {ends[0]:+.3f} off, with offset=True {ends[1]:+.1e}"
            print(f"D = {D:g}, {what:16}: {off}", flush=True)


def integral() -> None:
    law = npred.plant(Integral, kappa="lqr")
    for D in (1.0, 4.0):
        run = npred.simulate(
            law, npred.predictor(law, "rk4"), D=D, D_hat=D, X0=[0.0, 0.0], t_end=60.0, actuator="history", u0=[0.0]
        )
        print(f"D = {D:g} T: the output overshoots by {run.X[:, 0].max() - 1:.0%}", flush=True)
        aimed = npred.plant(Lag, aim=0.0, kappa={"law": "lqr", "R": [[0.1]]})
        run = npred.simulate(
            aimed, npred.predictor(aimed, "rk4"), D=D, D_hat=D, X0=[0.0], t_end=60.0, actuator="history",
            u0="equilibrium", setpoints={"aim": ([0.0], [1.0])}, observer=npred.observers.EKF(aimed, offset=True),
        )  # fmt: skip
        print(f"         with a set-point and offset=True by {max(run.X[:, 0].max() - 1, 0):.0%}", flush=True)


if __name__ == "__main__":
    for part in harness.chosen(__doc__, steps, errors, integral):
        part()

"""Loops on a real clock: jitter, lost samples and commands, late samples, stops, states and offsets not measured.

    python benchmarks/real_clock.py [timing] [stops] [unmeasured] [offset]

All loops are npred.simulate's on a real clock, 64 starts of the plant's box. A loop is lost where it leaves the finite
numbers, or ends further from its target than its box is wide. Distances are in half widths of the box.
"""

import harness
import numpy as np
from plants import Climber, DCMotor

import npred
from npred.plants import Plant

LOOPS, NX, BAND = 64, 41, 0.1
FOURTEEN_BITS = 2 * np.pi / 2**14  # of an encoder's turn


# plant, dt, D, seconds, whether D is unknown too
PLANTS = {
    "scalar": (npred.plant("scalar"), 0.001, 0.2, 10.0, True),
    "DC motor": (Plant("dc_motor", DCMotor), 0.001, 0.1, 15.0, True),
    "cart-pole": (npred.plant("cart_pole"), 0.001, 0.2, 12.0, True),
    "the paper's plant": (npred.plant("activator_repressor"), 0.005, 1.0, 40.0, True),
    "unicycle": (npred.plant("unicycle"), 0.001, 0.6, 20.0, False),
}  # fmt: skip
SHIFT = 0.37  # control steps: candidates of the delay are whole ones


def starts(plant, share=1.0):
    """64 states, of a part of the box around its middle."""
    (low, high), half = harness.box(plant), share * harness.half_widths(plant)
    return np.random.default_rng(0).uniform((low + high) / 2 - half, (low + high) / 2 + half, (LOOPS, plant.n))


def distance(plant, run):
    """From the target, (loops, times)."""
    return np.abs((run.X - plant.target(0.0)) / harness.half_widths(plant)).max(axis=-1)


def is_lost(plant, run):
    """(loops,)."""
    last = distance(plant, run)[:, -len(run.t) // 10 :]
    return ~(np.isfinite(last).all(axis=1) & (last.max(axis=1) < 2.0))


def settling(plant, run):
    """The time from which on a loop stays within BAND, (loops,); NaN where it never does."""
    outside = ~(distance(plant, run) < BAND)
    last = np.where(outside.any(axis=1), outside.shape[1] - 1 - outside[:, ::-1].argmax(axis=1), -1)
    return np.where(last + 1 < len(run.t), run.t[np.minimum(last + 1, len(run.t) - 1)], np.nan)


def timing():
    """±30 % jitter, 5 % of samples and of commands lost, samples ten control steps late."""
    errors = "worst error of D̂, ideal", "worst error of D̂", "allowed"
    harness.head("plant", "D", "lost, ideal", "lost", "that ideal keeps", *errors)
    for name, (plant, dt, D, seconds, unknown) in PLANTS.items():
        D, predictor = D + SHIFT * dt, npred.predictor(plant, "rk4", nx=NX)
        for law in [None, npred.DelayObserver(bounds=(0.25 * D, 2 * D))] if unknown else [None]:
            ideal, real = (
                npred.simulate(
                    plant, predictor, D=D, D_hat=1.5 * D if law else D, X0=starts(plant), t_end=seconds, dt=dt,
                    adaptation=law, actuator="history", every=10, timing=clock, measurement=sensors, progress=False,
                )
                for clock, sensors in (
                    (npred.Timing(), None),
                    (npred.Timing(jitter=0.3, lost=0.05), npred.Measurement(delay=10 * dt, drop=0.05)),
                )
            )  # fmt: skip
            lost = [is_lost(plant, run) for run in (ideal, real)]
            errors = [f"{1e3 * np.abs(run.D_hat[:, -1] - D).max():.2f} ms" if law else "" for run in (ideal, real)]
            allowed = f"{1e3 * (dt + 0.02 * D):.2f} ms" if law else ""
            row = [name, "unknown" if law else "known", lost[0].sum(), lost[1].sum(), (lost[1] & ~lost[0]).sum()]
            harness.row(*row, *errors, allowed)


def stops():
    """200 ms without samples, 50 times a minute; the watchdog waits 100 ms."""
    exactly = "exactly where samples are too old"
    harness.head("plant", "then", "lost", "handed over", exactly, "largest step of U then", "jump")
    for name, jump in (("scalar", 0.01), ("DC motor", 0.05), ("cart-pole", 0.1)):
        plant, dt, D, seconds, _ = PLANTS[name]
        for label, then in {"hold": "hold", "zero": "zero", "law": plant.declaration.kappa}.items():
            run = npred.simulate(
                plant, npred.predictor(plant, "rk4", nx=NX), D=D, D_hat=D, X0=starts(plant), t_end=seconds, dt=dt,
                actuator="history", timing=npred.Timing(jitter=0.3, lost=0.05, stop=0.2, stop_every=1.2),
                measurement=npred.Measurement(delay=0.01, drop=0.05), progress=False,
                watchdog=npred.Watchdog(after=0.1, then=then, jump=jump),
            )  # fmt: skip
            handed, step = run.clock.handed_over, np.abs(np.diff(run.U, axis=1)).max(axis=-1)
            near = handed[:, 1:] | handed[:, :-1]
            as_declared = (handed == (run.clock.age > 0.1)).all()
            row = [name, label, is_lost(plant, run).sum(), f"{100 * handed.mean():.1f} %", as_declared]
            harness.row(*row, f"{step[near].max():.4f}", jump)


def unmeasured():
    """From some states alone, quantised, against the full state; both on the clock of `timing`."""
    settles = "settles, full state", "settles", "ratio, median", "ratio, largest"
    harness.head("plant", "measured in steps of", "lost", *settles)
    cases = {
        "chemostat": (npred.plant("chemostat"), 0.01, 0.5, 30.0, ("S",), [0.01]),
        "cart-pole": (npred.plant("cart_pole"), 0.001, 0.1, 20.0, ("p", "theta"), [0.0001, FOURTEEN_BITS]),
        "cart-pole, coarser": (npred.plant("cart_pole"), 0.001, 0.1, 20.0, ("p", "theta"), [0.001, 0.001]),
    }
    for name, (plant, dt, D, seconds, outputs, resolution) in cases.items():
        full, part = (
            npred.simulate(
                plant, npred.predictor(plant, "rk4", nx=NX), D=D, D_hat=D, X0=starts(plant), t_end=seconds, dt=dt,
                every=5, actuator="history", timing=npred.Timing(jitter=0.3, lost=0.05), progress=False,
                measurement=npred.Measurement(delay=10 * dt, drop=0.05, **sensors), **named,
            )
            for sensors, named in (
                ({}, {}),
                ({"resolution": resolution}, {"observer": npred.observers.EKF(plant, outputs=outputs)}),
            )
        )  # fmt: skip
        times = settling(plant, full), settling(plant, part)
        ratio = times[1] / times[0]
        row = [name, ", ".join(f"{s} {r:.2g}" for s, r in zip(outputs, resolution, strict=True))]
        row += [is_lost(plant, part).sum(), *(f"{np.nanmedian(time):.2f} s" for time in times)]
        harness.row(*row, f"{np.nanmedian(ratio):.3f}", f"{ratio.max():.3f}")


def offset():
    """Gravity 10 % above the model's, without and with the offset observed, on the clock of `timing`."""
    harness.head("plant", "steady error without", "with EKF(offset=True)", "share")
    plant, dt, D = Plant("climber", Climber), 0.005, 0.2
    heavier = Plant("climber", Climber, {"gravity": 1.1 * 9.81})
    errors = []
    for observes in (False, True):
        run = npred.simulate(
            plant, npred.predictor(plant, "rk4", nx=NX), D=D, D_hat=D, X0=starts(plant, 0.5), t_end=60.0, dt=dt,
            actuator="history", truth=heavier, every=20, progress=False, u0="equilibrium",
            timing=npred.Timing(jitter=0.3, lost=0.05), measurement=npred.Measurement(delay=0.01, drop=0.05),
            observer=npred.observers.EKF(plant, offset=True) if observes else None,
        )  # fmt: skip
        errors.append(np.abs(run.X[:, -100:, 0].mean(axis=1) - 2.0).max())
    harness.row("climber", *(f"{e:.2e} m" for e in errors), f"{100 * errors[1] / errors[0]:.3f} %")


if __name__ == "__main__":
    for table in harness.chosen(__doc__, timing, stops, unmeasured, offset):
        table()
        print()

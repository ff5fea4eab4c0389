"""What the laws make of an actuator that nobody measures: the paper's plant, 30 loops a row (about a minute)."""

import numpy as np

import npred

PLANT = npred.plant("activator_repressor")
RK4 = npred.predictor("rk4", PLANT, nx=101)
DELAYS, STARTS = np.meshgrid([0.83, 1.0, 1.234, 1.37, 1.5], [0.3, 0.5, 1.0, 1.5, 2.0, 3.5], indexing="ij")
BOUNDS = (0.1, 4.0)
OFF = {name: value for name, value in PLANT.parameters.items() if name.startswith("K")}
LAWS = {
    "(12), u measured": (npred.DelayAdaptation(1000.0, 1.0, BOUNDS), "measured"),
    "(12), own commands": (npred.DelayAdaptation(1000.0, 1.0, BOUNDS), "history"),
    "L1, own commands": (npred.L1Adaptation(1.0, 1.0, BOUNDS), "history"),
    "observers, own commands": (npred.DelayObserver(bounds=BOUNDS), "history"),
}
REALITIES = {
    "": {},
    ", 3 % noise": {"measurement": npred.Measurement(noise=0.03)},
    ", 1 % noise, sampled each 50 ms ± 15 ms": {"measurement": npred.Measurement(noise=0.01, period=0.05, jitter=0.3)},
    ", plant 3 % off": {"truth": npred.plant("activator_repressor", **{k: 1.03 * v for k, v in OFF.items()})},
    ", disturbance .002 sin(.7 t)": {"disturbance": lambda t: [0.002 * np.sin(0.7 * t)]},
}


def row(name: str, law: npred.DelayLaw, actuator: str, reality: dict) -> str:
    """A line of the table: lost loops, those whose state leaves the numbers or ends farther than 2 from rest."""
    loops = npred.simulate(
        PLANT, RK4, D=DELAYS, D_hat=STARTS, X0=[0.03, 30.0], t_end=60.0, dt=0.005, adaptation=law, actuator=actuator,
        **reality,
    )  # fmt: skip
    radii = np.abs(loops.X[..., -1000:, :] - PLANT.equilibrium).max(axis=(-1, -2))
    errors = np.abs(loops.D_hat[..., 2000:] - DELAYS[..., None]).max()
    return f"| {name} | {(~(radii < 2)).sum()} | {radii.max():.1e} | {errors:.4f} s |"


if __name__ == "__main__":
    for label, (law, actuator) in LAWS.items():
        for reality, settings in (REALITIES if "observers" in label else {"": {}}).items():
            print(row(label + reality, law, actuator, settings), flush=True)

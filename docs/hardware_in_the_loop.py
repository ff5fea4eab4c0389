"""Hardware in the loop: the controller of npred at one end, and a plant behind a delay line, of which it knows nothing.

Run it with `python docs/hardware_in_the_loop.py`. On a real plant, `Rig` is what talks to the hardware.
"""

from collections import deque

import numpy as np

import npred

DT, D, NX = 0.005, 1.0, 101  # control step and true delay in seconds; nodes of the actuator state


class Rig:
    """X' = f(X, U(t - D)) in steps of DT, and the delay line that holds the last D seconds of U."""

    def __init__(self, plant) -> None:
        self.plant, self.X = plant, np.array([0.03, 30.0])
        self.line = deque([np.zeros(plant.m)] * round(D / DT), maxlen=round(D / DT))

    def measure(self) -> tuple[np.ndarray, np.ndarray]:
        """X, and u on NX nodes: the node at x carries what arrives after D x seconds."""
        rows = np.minimum(np.linspace(0, 1, NX) * len(self.line) + 1e-9, len(self.line) - 1).astype(int)
        return self.X, np.array(self.line)[rows]

    def apply(self, U: np.ndarray) -> None:
        """Send U into the line; the plant gets what leaves it."""
        arriving = self.line[0]
        self.line.append(U.copy())
        slope = self.plant.f(self.X, arriving)
        self.X = self.X + DT / 2 * (slope + self.plant.f(self.X + DT * slope, arriving))


def main(t_end: float = 60.0) -> tuple[np.ndarray, float]:
    """Run the loop; the last state and delay estimate."""
    plant = npred.plant("activator_repressor")
    predictor = npred.predictor("rk4", plant, nx=NX)  # or npred.load("pipeline/paper.toml:deeponet", nx=NX)
    adaptation = npred.DelayAdaptation(gamma=1000.0, b=1.0, bounds=(0.1, 4.0))
    controller, rig = npred.controller(plant, predictor, adaptation, DT, D_hat=2.0), Rig(plant)
    for _ in range(round(t_end / DT)):
        rig.apply(controller.step(*rig.measure()))
    return rig.X, controller.D_hat


if __name__ == "__main__":
    X, D_hat = main()
    print(f"X = {X}, D_hat = {D_hat:.3f} s")

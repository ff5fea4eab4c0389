"""Plants with limits, of benchmarks/promises.py: far aims, doors, set-points that move, curves ahead.

The inputs of all but three are bounded; a brake may take longer than the law's time constants.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import plants
from plants import declared, derived

import npred
from npred.plants import Plant, inputs


@dataclass(frozen=True)
class Case:
    """A plant and its delay; size is that of h, `moves` its set-points, `aim` the range in which one may move."""

    name: str
    plant: Plant
    D: float
    t_end: float
    size: float = 1.0
    dt: float = 0.01
    moves: Any = None
    aim: tuple[str, float, float] | None = None

    @property
    def delay(self) -> float:
        """How wrong D_hat may be: control steps."""
        return self.dt * max(round(self.D / self.dt / 10), 1)

    @property
    def bounds(self) -> np.ndarray:
        """Of U, (m, 2); where a plant has none, 1.5 from what U is before t = 0."""
        bounds = inputs.widest(self.plant, inputs.bounds(self.plant, None))
        return np.where(np.isfinite(bounds), bounds, self.before[:, None] + np.array([-1.5, 1.5]))

    @property
    def before(self) -> np.ndarray:
        """U before t = 0, (m,)."""
        return self.plant.u_target(0.0)


def mass(aim: float, safe: Any, *box: Any) -> Plant:
    """A mass with |u| <= 1, whose law is fast beside that."""
    return npred.plant(declared(
        "Mass", "x v", "u", lambda x, u, t, p, M: [x.v, u.u], box, (-1.0, 1.0), aim=("x", aim), guess=(aim, 0.0),
        kappa=lambda x, t, p, M: [-25.0 * (x.x - p.aim) - 10.0 * x.v], safe=safe,
    ))  # fmt: skip


def jerked(aim: float, safe: Any, *box: Any) -> Plant:
    """A mass whose acceleration changes by at most 1 a second."""
    return npred.plant(declared(
        "Jerked", "x v a", "u", lambda x, u, t, p, M: [x.v, x.a, u.u], box, (-1.0, 1.0), aim=("x", aim),
        guess=(aim, 0.0, 0.0), kappa=lambda x, t, p, M: [-8.0 * (x.x - p.aim) - 12.0 * x.v - 6.0 * x.a], safe=safe,
    ))  # fmt: skip


def designed(*of: Any, **parts: Any) -> Plant:
    return npred.plant(declared(*of, **parts), kappa="lqr")


def model(name: str, of: str, *box: Any, **parts: Any) -> Plant:
    """One of benchmarks/plants.py's forty, with the law of its linearisation."""
    one = plants.MODELS[of]
    return designed(
        name, " ".join(one.box), " ".join(one.inputs), lambda x, u, t, p, M: one.f(x, u, M),
        box or [*one.box.values()],
        *one.inputs.values(), **parts,
    )  # fmt: skip


def limited(base: type, *bounds: Any, **parts: Any) -> Plant:
    return npred.plant(derived(base.__name__, base, input_bounds=bounds, **parts))


def ramp(t: Any, begins: float, lasts: float, M: Any) -> Any:
    """From 0 to 1."""
    return M.minimum(M.maximum((t - begins) / lasts, 0.0), 1.0)


def _bend(t: Any, M: Any) -> Any:
    return 0.012 * ramp(t, 1.5, 1.0, M)  # of 83 m


def _ahead(t: Any, M: Any) -> Any:
    return 15.0 * (1 - ramp(t, 2.0, 4.0, M))  # of a car that stops


Bend = declared(  # benchmarks/plants.py's lane, and a curve in it
    "Bend", "y psi delta", "steer",
    lambda x, u, t, p, M: [
        20.0 * M.sin(x.psi), 20.0 / 2.7 * M.tan(x.delta) - 20.0 * _bend(t, M), (u.steer - x.delta) / 0.1
    ],
    [(-1.0, 1.0), (-0.1, 0.1), (-0.02, 0.02)], (-0.06, 0.06), reference=lambda t, p, M: [0.0, 0.0, 2.7 * _bend(t, M)],
    kappa=lambda x, t, p, M: [2.7 * _bend(t, M) - 0.01 * x.y - 0.25 * x.psi - 0.3 * (x.delta - 2.7 * _bend(t, M))],
    safe=lambda x, t, p, M: [1.2 - x.y, 1.2 + x.y],
)  # fmt: skip
Follow = declared(
    "Follow", "gap v", "u", lambda x, u, t, p, M: [_ahead(t, M) - x.v, u.u], [(10.0, 45.0), (8.0, 20.0)], (-5.0, 2.0),
    reference=lambda t, p, M: [5.0, _ahead(t, M)], safe=lambda x, t, p, M: [x.gap - 2.0],
    kappa=lambda x, t, p, M: [0.5 * (x.gap - 5.0) + 1.2 * (_ahead(t, M) - x.v)],
)  # fmt: skip
Crane = declared(  # a load that hangs 1 m below its trolley, and must not swing
    "Crane", "p v theta omega", "a",
    lambda x, u, t, p, M: [x.v, u.a, x.omega, -9.81 * M.sin(x.theta) - u.a * M.cos(x.theta) - 0.1 * x.omega],
    [(-1.0, 5.0), (-1.0, 1.5), (-0.06, 0.06), (-0.15, 0.15)], (-1.0, 1.0), aim=("p", 5.0), guess=(5.0, 0.0, 0.0, 0.0),
    safe=lambda x, t, p, M: [5.1 - x.p, 0.12 - x.theta, 0.12 + x.theta],
)  # fmt: skip
Round = declared(  # a mass in the plane, and a pillar on its way
    "Round", "x y vx vy", "ax ay", lambda x, u, t, p, M: [x.vx, x.vy, u.ax, u.ay],
    [(-1.0, 1.0), (-1.0, 1.0), (-0.5, 1.5), (-0.5, 0.5)], (-1.0, 1.0), (-1.0, 1.0), guess=(5.0, 0.0, 0.0, 0.0),
    kappa=lambda x, t, p, M: [-4.0 * (x.x - 5.0) - 4.0 * x.vx, -4.0 * x.y - 4.0 * x.vy],
    safe=lambda x, t, p, M: [(x.x - 2.5) ** 2 + (x.y - 0.3) ** 2 - 0.8],
)  # fmt: skip
Land = declared(  # falls from up to 10 m to .3 m above the ground; its thrust brakes by at most 2.2 m/s²
    "Land", "z v", "thrust", lambda x, u, t, p, M: [x.v, u.thrust - 9.81], [(1.0, 10.0), (-5.0, 1.0)], (0.0, 12.0),
    guess=(0.3, 0.0), kappa=lambda x, t, p, M: [9.81 - 4.0 * (x.z - 0.3) - 4.0 * x.v], safe=lambda x, t, p, M: [x.z],
)  # fmt: skip
Unstable = declared(
    "Unstable", "x", "u", lambda x, u, t, p, M: [x.x + u.u], [(-0.7, 0.7)], (-1.0, 1.0), aim=("x", 0.8), guess=(0.8,),
    kappa=lambda x, t, p, M: [-x.x - 4.0 * (x.x - p.aim)], safe=lambda x, t, p, M: [0.9 - x.x, 0.9 + x.x],
)  # fmt: skip
Swing = declared(  # a pendulum whose torque holds it at 1.2 rad with a tenth to spare, and whose rate is limited
    "Swing", "angle rate", "torque", lambda x, u, t, p, M: [x.rate, u.torque - 9.81 * M.sin(x.angle)],
    [(-0.5, 1.2), (-0.8, 0.8)], (-10.5, 10.5), aim=("angle", 0.3),
    kappa=lambda x, t, p, M: [9.81 * M.sin(x.angle) - 9.0 * (x.angle - p.aim) - 6.0 * x.rate],
    safe=lambda x, t, p, M: [1.3 - x.angle, 1.0 - x.rate, 1.0 + x.rate],
)  # fmt: skip
Speedy = declared(  # jerked, with limits of speed and acceleration
    "Speedy", "x v a", "u", lambda x, u, t, p, M: [x.v, x.a, u.u], [(-1.0, 4.0), (-0.5, 0.8), (-0.4, 0.4)], (-1.0, 1.0),
    aim=("x", 0.0), kappa=lambda x, t, p, M: [-8.0 * (x.x - p.aim) - 12.0 * x.v - 6.0 * x.a],
    safe=lambda x, t, p, M: [5.2 - x.x, 1.0 - x.v, 0.6 - x.a, 0.6 + x.a],
)  # fmt: skip
Oscillator = derived(
    "Oscillator", plants.Oscillator, parameters={"mu": 1.0, "aim": 1.2}, input_bounds=((-3.0, 3.0),),
    safe=lambda x, t, p, M: [1.5 - x.x1, 1.5 + x.x1],
)  # fmt: skip
Ship = declared(
    "Ship", "heading r rudder", "order",
    lambda x, u, t, p, M: [x.r, (0.2 * x.rudder - x.r - 400.0 * x.r**3) / 20.0, (u.order - x.rudder) / 2.0],
    [(-0.3, 0.5), (-0.03, 0.03), (-0.4, 0.4)], (-0.6, 0.6), aim=("heading", 0.5), guess=(0.5, 0.0, 0.0),
    safe=lambda x, t, p, M: [0.52 - x.heading, 0.03 - x.r, 0.03 + x.r],
)  # fmt: skip


def cases() -> dict[str, Case]:
    """The cases by name."""
    aimed, arm = plants.AIMED, plants.Arm
    every = (
        Case("near", mass(0.95, lambda x, t, p, M: [1 - x.x, 1 + x.x], (-0.9, 0.9), (-1.2, 1.2)), 0.3, 8.0),
        Case("wall", mass(5.0, lambda x, t, p, M: [5.5 - x.x], (-1.0, 5.0), (-2.0, 2.5)), 0.3, 15.0),
        Case("far", mass(20.0, lambda x, t, p, M: [20.5 - x.x], (-1.0, 20.0), (-3.0, 6.0)), 0.3, 30.0),
        Case(
            "moved",
            mass(0.0, lambda x, t, p, M: [10.2 - x.x], (-1.0, 9.0), (-1.0, 3.0)), 0.3, 20.0,
            moves={"aim": ([1.0], [10.0])}, aim=("aim", -5.0, 12.0),
        ),
        Case(
            "door",
            mass(5.0, lambda x, t, p, M: [M.maximum(10.0 - 1.2 * t, 5.2) - x.x], (0.0, 9.0), (-2.0, 2.0)), 0.3, 15.0
        ),
        Case(
            "gate",
            mass(0.2, lambda x, t, p, M: [M.maximum(3.0 - 0.5 * t, 0.3) - x.x, M.maximum(3.0 - 0.5 * t, 0.3) + x.x],
                 (-2.5, 2.5), (-1.5, 1.5)), 0.3, 12.0,
        ),
        Case(
            "jerked",
            jerked(5.0, lambda x, t, p, M: [5.5 - x.x], (-1.0, 4.5), (-0.5, 1.2), (-0.5, 0.5)), 0.3, 20.0
        ),
        Case(
            "speedy",
            npred.plant(Speedy), 0.3, 20.0, moves={"aim": ([1.0], [5.0])}, aim=("aim", -2.0, 5.5)
        ),
        Case("lane", npred.plant(plants.Lane), 0.15, 8.0, 1.2),
        Case("bend", npred.plant(Bend), 0.15, 10.0, 1.2),
        Case("follow", npred.plant(Follow), 0.3, 15.0, 10.0),
        Case("pendulum", npred.plant(plants.Pendulum), 0.1, 8.0, 1.2),
        Case("swing", npred.plant(Swing), 0.1, 10.0, moves={"aim": ([2.0], [1.2])}, aim=("aim", -1.0, 1.25)),
        Case("series", npred.plant(plants.Series), 0.5, 25.0, 0.1, 0.02),
        Case(
            "levels",
            npred.plant(derived("Levels", plants.TwoTanks, safe=lambda x, t, p, M: [
                1.3 - x.h1, 2.6 - x.h2, x.h1 - 0.6, x.h2 - 1.0
            ], box={"h1": (0.6, 1.4), "h2": (0.9, 2.6)}), kappa="lqr"), 0.5, 25.0, 0.5, 0.02,
            moves={"second": ([5.0], [2.55])}, aim=("second", 1.0, 3.0),
        ),
        Case(
            "reactor",
            model("Reactor", "reactor", guess=(0.5, 350.0), safe=lambda x, t, p, M: [356.0 - x.T, x.T - 344.0]),
            0.1, 8.0, 6.0,
        ),
        Case("elbow", npred.plant(plants.Elbow), 0.1, 8.0, 0.3),
        Case(
            "stops",
            limited(arm, (-20.0, 20.0), (-8.0, 8.0), safe=lambda x, t, p, M: [
                0.45 - x.theta1, x.theta1 + 0.05, 0.9 - x.theta2, x.theta2 - 0.25,
                1.0 - x.omega1, 1.0 + x.omega1, 1.0 - x.omega2, 1.0 + x.omega2,
            ]), 0.1, 6.0, 0.3,
        ),
        Case("pole", npred.plant(plants.Pole, kappa="lqr"), 0.12, 20.0, 0.6, 0.005),
        Case("drone", npred.plant(plants.Drone), 0.2, 20.0, 0.45),
        Case("aircraft", limited(
            plants.Aircraft, (0.0, 2.0), (-1.0, 1.0), box=plants.Aircraft.box | {"x": (-3.0, 3.0), "omega": (-0.3, 0.3)}
        ), 0.2, 10.0, 0.25),
        Case("land", npred.plant(Land), 0.2, 15.0),
        Case(
            "motor",
            designed(
                "Current", "w i", "U", aimed["Motor"].f, [(0.0, 100.0), (-4.0, 7.0)], (-24.0, 24.0), aim=("w", 50.0),
                guess=(50.0, 2.0), safe=lambda x, t, p, M: [8.0 - x.i, 8.0 + x.i],
            ), 0.02, 1.0, 8.0, 0.002, moves={"aim": ([0.2], [100.0])}, aim=("aim", 0.0, 150.0),
        ),
        Case(
            "servo",
            designed(
                "Servo", "a w", "U", aimed["Servo"].f, [(-1.0, 0.8), (-2.0, 2.0)], (-2.0, 2.0), aim=("a", 0.0),
                safe=lambda x, t, p, M: [1.0 - x.a, 1.0 - x.w],
            ), 0.1, 8.0, moves={"aim": ([1.0], [0.97])}, aim=("aim", -1.0, 1.1),
        ),
        Case("crane", npred.plant(Crane, kappa="lqr"), 0.2, 20.0, 0.12),
        Case(
            "beam",
            model("Beam", "ball and beam", (-0.5, 0.5), (-0.6, 0.6), aim=("r", 0.5), guess=(0.5, 0.0),
                  safe=lambda x, t, p, M: [0.55 - x.r, 0.55 + x.r]), 0.15, 8.0, 0.5,
        ),
        Case(
            "magnet",
            model("Magnet", "magnet", guess=(1.2e-2, 0.0),
                  safe=lambda x, t, p, M: [0.018 - x.gap, x.gap - 0.006]), 0.01, 1.0, 0.01, 0.001,
        ),
        Case("oscillator", npred.plant(Oscillator, kappa="lqr"), 0.2, 10.0, 1.5),
        Case("unstable", npred.plant(Unstable), 0.2, 6.0),
        Case("cubic", limited(plants.Cubic, (-5.0, 5.0)), 0.2, 6.0),
        Case("steep", npred.plant(plants.Cubic), 0.6, 6.0),
        Case("arm", npred.plant(arm), 0.1, 6.0, 0.3),
        Case("clock", npred.plant(plants.Clock), 0.3, 10.0),
        Case("tank", limited(plants.Tank, (-30.0, 0.0)), 2.0, 60.0, 4.0, 0.05),
        Case("round", npred.plant(Round), 0.2, 15.0),
        Case(
            "joint",
            model("Joint", "flexible joint", guess=(0.7, 0.9, 0.0, 0.0), aim=("link", 0.7),
                  safe=lambda x, t, p, M: [0.75 - x.link, 0.75 + x.link]), 0.05, 8.0, 0.75,
        ),
        Case("ship", npred.plant(Ship, kappa="lqr"), 3.0, 200.0, 0.03, 0.25),
    )  # fmt: skip
    return {case.name: case for case in every}

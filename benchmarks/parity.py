"""One description, every way to run it: the largest difference of U, and statuses that differ.

    python benchmarks/parity.py [--count 200] [--first 0] [--seed 0] [--ways clock,pipeline,controller,rig,c,fmu]
        [--adversary]

Random descriptions of a loop (plant, predictor, law, observer, filter, watchdog, gate, ages, jitter, losses, faults,
set-points, bounds, u0, disturbance, mismatch) are run by npred.simulate as they are, by npred.simulate on a clock
(`timing`), as a pipeline's table, by npred.controller around a plant of this file, by the same around the plant of
npred rig in simulated time, and by the exported C and the FMU, which get the same calls; an FMU is called on time,
with a sample. The plant of this file, its sensors and the way of the commands share no code with npred: NumPy, event by
event.
Differences of U are in the half widths of its bounds, else of its range in the loop. A refused description is
counted by its words. With --adversary new descriptions are made of those that differ most so far.
"""

import collections
import ctypes
import math
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import harness
import numpy as np

import npred
from npred.base.errors import DivergedError, NpredError
from npred.lab.config import Evaluate
from npred.lab.config.conditions import Condition
from npred.loop.timing import Schedule, schedule
from npred.loop.trajectories import Trajectories
from npred_rig import sides
from npred_rig.network import Packet

PLANTS = {"van_der_pol": (0.02, 0.4), "scalar": (0.02, 0.5), "cart_pole": (0.01, 0.12), "planar_arm2": (0.01, 0.1),
          "activator_repressor": (0.02, 0.6), "unicycle": (0.02, 0.3)}  # fmt: skip
STEPS = 150
AGREE = 1e-9
TAKEN = (0, 7)  # the codes of a set-point that is taken; 7 says that its rest breaks a limit


class Sine(NamedTuple):
    """A disturbance."""

    amplitude: float
    omega: float
    m: int

    def __call__(self, t: float) -> list[float]:
        return [self.amplitude * math.sin(self.omega * t)] * self.m


class Bounded:
    """A cart before a wall, with a set-point and an output."""

    states, inputs, outputs, parameters = ("x", "v"), ("u",), ("x_m",), {"aim": 0.3}
    box, input_bounds, guess = {"x": (-1.0, 1.0), "v": (-1.0, 1.0)}, ((-3.0, 3.0),), (0.3, 0.0)

    def f(x, u, t, p, M):
        return [x.v, u.u - 0.4 * x.v]

    def kappa(x, t, p, M):
        return [-4 * (x.x - p.aim) - 2.6 * x.v]

    def output(x, t, p, M):
        return [x.x]

    def setpoint(x, t, p, M):
        return [x.x - p.aim]

    def safe(x, t, p, M):
        return [0.8 - x.x]


@cache
def _plant(name: str) -> npred.plants.Plant:
    return npred.plant(Bounded if name == "bounded" else name)


def described(rng: np.random.Generator) -> dict[str, Any]:
    """A random description: the arguments of npred.simulate."""

    def sometimes(share: float, value: Callable[[], Any]) -> Any:
        return value() if rng.random() < share else None

    name = str(rng.choice([*PLANTS, "bounded", "bounded"]))
    plant, (dt, D) = _plant(name), PLANTS.get(name, (0.02, 0.3))
    method, nx = str(rng.choice(["rk4", "heun", "euler"])), int(rng.choice([11, 31]))
    middle = np.array([plant.target(0.0), plant.guess][0 if plant.rests else 1])
    half = np.array([np.ptp(plant.box[s]) / 2 if s in plant.box else 1.0 for s in plant.states])
    D_hat = D * float(rng.choice([1.0, 1.0, 0.7, 1.3]))
    history = rng.random() < 0.85
    loop: dict[str, Any] = {
        "plant": plant, "predictor": npred.predictor(plant, method, nx), "D": D, "D_hat": D_hat, "dt": dt,
        "X0": middle + 0.6 * half * rng.uniform(-1, 1, plant.n), "t_end": STEPS * dt,
        "actuator": "history" if history else "measured",
    }  # fmt: skip
    noise = float(rng.choice([0.0, 0.003, 0.2]))
    sensors = {
        "noise": tuple(noise * half), "bias": sometimes(0.2, lambda: tuple(0.05 * half)),
        "resolution": sometimes(0.2, lambda: tuple(0.01 * half)), "drop": sometimes(0.2, lambda: 0.1),
        "period": sometimes(0.2, lambda: 3 * dt), "delay": sometimes(0.3, lambda: float(rng.choice([2, 30])) * dt),
    }  # fmt: skip
    more: dict[str, Any] = {
        "measurement": sometimes(0.5, lambda: {k: v for k, v in sensors.items() if v is not None}),
        "adaptation": sometimes(0.3, lambda: npred.DelayObserver(bounds=(0.4 * D, 2 * D))),
        "input_bounds": sometimes(0.2, lambda: [(-2.0, 2.0)] * plant.m),
        "u0": sometimes(0.6, lambda: rng.choice(["equilibrium", "law"])),
        "disturbance": sometimes(0.3, lambda: Sine(0.3, 5.0, plant.m)),
        "outlier_limit": sometimes(0.2, lambda: float(rng.choice([0.2, 3.0]))),
        "max_sample_age": sometimes(0.2, lambda: 40 * dt),
        "watchdog": sometimes(0.15, lambda: npred.Watchdog(after=4 * dt, then="zero")),
        "truth": sometimes(0.2, lambda: _varied(plant)),
    }
    if name == "bounded":
        more |= {
            "safety": sometimes(0.4, lambda: npred.SafetyFilter()),
            "observer": sometimes(0.4, lambda: npred.observers.EKF(plant, offset=bool(rng.random() < 0.5))),
            "setpoints": sometimes(0.4, lambda: {"aim": ([0.5, 1.5], [-0.2, 0.5])}),
        }
    loop |= {key: value for key, value in more.items() if value is not None}
    if (sensors := loop.get("measurement")) is not None:
        sensors = {k: v[:1] if "observer" in loop and isinstance(v, tuple) else v for k, v in sensors.items()}
        loop["measurement"] = npred.Measurement(**sensors, seed=int(rng.integers(99)))
    if history and rng.random() < 0.3:
        jitter, lost = float(rng.choice([0.0, 0.3])), float(rng.choice([0.0, 0.1]))
        travels = {way: sometimes(0.4, lambda: _latency(rng, dt)) for way in ("sample_latency", "command_latency")}
        travels = {way: latency for way, latency in travels.items() if latency}
        loop["timing"] = npred.Timing(jitter, lost, overrun=lost / 2, tells=True, seed=_seed(loop), **travels)
    sensors, clock = loop.get("measurement"), history and {"timing", "observer", "watchdog"} & loop.keys()
    for name, acts in (
        ("outlier_limit", clock),
        ("max_sample_age", clock and _late(sensors, loop.get("timing"))),
    ):
        if not acts:
            loop.pop(name, None)
    return loop


def _late(sensors: Any, timing: Any) -> bool:
    return bool((sensors and (sensors.period or sensors.delay)) or (timing and timing.sample_latency))


def _latency(rng: np.random.Generator, dt: float) -> Any:
    """Of each packet in turn, or the quantiles of a distribution."""
    steps = dt * np.array(rng.choice([0.0, 1.0, 2.5, 6.0, np.inf], 5, p=[0.3, 0.3, 0.2, 0.1, 0.1]))
    return [dt, *steps] if rng.random() < 0.5 else [(0.0, 0.2 * dt), (0.9, dt), (1.0, 5 * dt)]


def _seed(loop: dict[str, Any]) -> int:
    return loop["measurement"].seed if "measurement" in loop else 0


def _varied(plant: Any) -> Any:
    """The plant with its parameters 5 % larger, or None where it has none."""
    import npred.plants as plants

    values = {name: 1.05 * value for name, value in plant.parameters.items() if name != "aim"}
    return plants.varied(plant, tuple(values.items())) if values else None


# the plant of this file


def _uniform(*parts: int) -> float:
    """SplitMix64, a round for each number."""
    z, mask = 0x9E3779B97F4A7C15, 2**64 - 1
    for part in parts:
        z = ((z ^ (part & mask)) + 0x9E3779B97F4A7C15) & mask
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        z ^= z >> 31
    return ((z >> 11) + 0.5) / 2.0**53


def sensed(y: np.ndarray, m: npred.Measurement, number: int) -> np.ndarray:
    """A sample of y with noise, bias and resolution, as docs/real_loop.md states them."""
    values = []
    for c, value in enumerate(y.tolist()):
        noise, bias, step = (
            (v[c] if isinstance(v, tuple) else v) for v in (m.noise, m.bias, m.resolution)
        )  # fmt: skip
        if noise:
            radius = math.sqrt(-2 * math.log(_uniform(m.seed, 0, number, c, 4)))
            value += noise * radius * math.cos(2 * math.pi * _uniform(m.seed, 0, number, c, -4))
        value += bias
        values.append(value - math.remainder(value, step) if step else value)
    return np.array(values)


class Own:
    """The plant, its commands and its sensors, event by event; times in control steps."""

    def __init__(self, loop: dict[str, Any], past: np.ndarray) -> None:
        self.plant, self.X, self.at = loop.get("truth") or loop["plant"], np.array(loop["X0"], dtype=float), 0.0
        self.dt, self.D = loop["dt"], loop["plant"].ratios * loop["D"] / loop["dt"]
        before = (-float(k) for k in range(math.ceil(self.D.max()) + 1, 0, -1))  # a step of RK4 ends where each arrives
        self.push, self.sent = loop.get("disturbance"), [(-math.inf, past), *((at, past) for at in before)]

    def go(self, to: float) -> None:
        """RK4 between all moments at which an input switches or a control step begins."""
        while self.at < to:
            switches = [s + D for s, _ in self.sent for D in self.D if s + D > self.at + 1e-9]
            end = min([to, math.floor(self.at + 1e-9) + 1.0, *switches])
            end = round(end) if abs(end - round(end)) < 1e-9 else end
            u = np.array([self._acting(c) for c in range(self.plant.m)])
            if self.push:
                u = u + self.push((math.floor(self.at + 1e-9) + 0.5) * self.dt)
            self.X, self.at = self._rk4(u, (end - self.at) * self.dt, self.at * self.dt), end

    def _acting(self, c: int) -> float:
        return next(U[c] for s, U in reversed(self.sent) if s + self.D[c] <= self.at + 1e-9)

    def _rk4(self, u: np.ndarray, h: float, t: float) -> np.ndarray:
        f = lambda x, s: np.asarray(self.plant.f(x, u, s))  # noqa: E731
        k1 = f(self.X, t)
        k2 = f(self.X + h / 2 * k1, t + h / 2)
        k3 = f(self.X + h / 2 * k2, t + h / 2)
        k4 = f(self.X + h * k3, t + h)
        return self.X + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def events(loop: dict[str, Any]) -> Schedule:
    timing, measurement = loop.get("timing") or npred.Timing(), loop.get("measurement") or npred.Measurement()
    return schedule(timing, measurement, loop["dt"], STEPS + 1, 0)


class OnRig(Own):
    """The plant of npred rig in simulated time, which the commands reach at once."""

    def __init__(self, loop: dict[str, Any], past: np.ndarray) -> None:
        super().__init__(loop, past)
        table = _table(loop)
        self.rig = sides.DelayedPlant(self.plant, table, past)
        self.rig.step = self.dt  # as the other plant

    def go(self, to: float) -> None:
        for number, (at, U) in enumerate((at, U) for at, U in self.sent if 0 <= at < to):
            self.rig.command(Packet(at * self.dt, number, at * self.dt, U))
        self.X = self.rig.to(to * self.dt).copy()


def _table(loop: dict[str, Any]) -> Evaluate:
    """The description as a pipeline's table [evaluate]."""
    law, keys = loop.get("adaptation"), ("dt", "input_bounds", "u0", "actuator", "outlier_limit", "max_sample_age")
    table = {key: loop[key] for key in keys if key in loop} | {
        "t_end": loop["t_end"],
        "D": loop["D"],
        "D_hat": loop["D_hat"],
    }
    table |= {"X0": loop["X0"].tolist(), "adaptation": "delay-observer" if law else "frozen"}
    table |= {"bounds": law.bounds} if law else {}
    if push := loop.get("disturbance"):
        table["disturbance"] = {"amplitude": push.amplitude, "omega": push.omega}
    if truth := loop.get("truth"):
        table["truth"] = {k: v for k, v in truth.parameters.items() if v != loop["plant"].parameters[k]}
    if sensors := loop.get("measurement"):
        table["measurement"] = {k: v for k, v in vars(sensors).items() if k not in ("seed", "first", "observer")}
    if timing := loop.get("timing"):
        table["timing"] = {k: v for k, v in vars(timing).items() if k != "seed"}
    if watchdog := loop.get("watchdog"):
        table["watchdog"] = {"after": watchdog.after, "then": watchdog.then}
    if "safety" in loop:
        table["safety"] = {}
    if observer := loop.get("observer"):
        table["observer"] = {"kind": "ekf", "offset": observer.offset}
    table["setpoints"] = {k: {"at": at, "to": to} for k, (at, to) in loop.get("setpoints", {}).items()}
    return Evaluate.model_validate({k: v for k, v in table.items() if v is not None})


def by_pipeline(loop: dict[str, Any]) -> np.ndarray:
    """U of the loop of a pipeline's table."""
    one = (np.array([value]) for value in (loop["X0"], loop["D"], loop["D_hat"]))
    condition = Condition(_table(loop), *one, loop["t_end"], seed=_seed(loop))
    return condition.loops(loop["plant"], loop["predictor"], every=1, progress=False).U[0]


CONTROLLER = ("input_bounds", "u0", "observer", "watchdog", "safety", "outlier_limit", "max_sample_age")


def by_controller(
    loop: dict[str, Any], world: type[Own] = Own
) -> tuple[np.ndarray, dict[str, float], Any, list[tuple[Any, ...]]]:
    """U of npred.controller around the plant of this file, its counts, itself, and its calls."""
    given = {name: loop[name] for name in CONTROLLER if name in loop}
    if given.get("u0") == "law":
        given["u0"] = np.clip(loop["plant"].kappa(loop["X0"]), *np.array(_bounds(loop)).T)
    c = npred.controller(
        loop["plant"], loop["predictor"], loop.get("adaptation"), loop["dt"], D_hat=loop["D_hat"], **given
    )
    start, plan, own = c.fresh(), events(loop), world(loop, c.u0)
    measurement, course = loop.get("measurement") or npred.Measurement(), dict(loop.get("setpoints") or {})
    taken: dict[int, np.ndarray] = {}
    order, U, calls, last, lost = list(enumerate(plan.taken)), [], [], c.u0, None
    for k in range(STEPS + 1):
        values = {}
        for name, (times, goals) in course.items():
            for time, goal in zip(times, goals, strict=True):
                if k - 1 < time / loop["dt"] - 1e-6 <= k:
                    values[name] = goal
        if values:
            c.set(**values)
        if not plan.skipped[k]:
            while order and order[0][1] <= plan.at[k]:
                row, moment = order.pop(0)
                own.go(moment)
                Y = own.X if "observer" not in loop else np.array([own.X[0]])
                taken[row] = sensed(Y, measurement, int(plan.number[row]))
            own.go(plan.at[k])
            t, row = plan.at[k] * loop["dt"], plan.sample[k]
            X = taken[row] if row >= 0 else None
            at = None if row < 0 else t - plan.age[k] * loop["dt"]
            applied = last if lost is not None else None
            calls.append((t, X, at, applied, values))
            refused = False
            try:
                u = c.step(X, t=t, sampled_at=at, applied=applied).copy()
                lost = u if plan.lost[k] else None
                if lost is None:
                    while own.sent[-1][0] >= plan.reaches[k]:
                        own.sent.pop()
                    own.sent.append((plan.reaches[k], u))
                    last = u
            except DivergedError:
                u, lost, refused = c.memory.signals.U[:, 0].copy(), None, True
            calls[-1] += (u, refused)
        U.append(u)
    status = c.status
    return np.array(U), {"late": status.late, "refused": status.refused}, start, calls


def _bounds(loop: dict[str, Any]) -> Any:
    return loop.get("input_bounds") or loop["plant"].input_bounds or [(-np.inf, np.inf)] * loop["plant"].m


def by_c(controller: Any, calls: list[tuple[Any, ...]]) -> float:
    """The largest difference of U of the exported C from that of the same calls in Python."""
    with tempfile.TemporaryDirectory() as folder:
        npred.export(controller, "controller", Path(folder))
        extra = "unsigned long size(void);\nunsigned long size(void) { return sizeof(npred_controller); }\n"
        (Path(folder) / "all.c").write_text(f'#include "npred.c"\n{extra}')
        command = ["cc", "-std=c99", "-O2", "-shared", "-fPIC", "all.c", "-o", "all.so", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
        library = ctypes.CDLL(f"{folder}/all.so")
    library.size.restype = ctypes.c_ulong
    memory, worst = ctypes.create_string_buffer(library.size()), 0.0
    library.npred_init(memory)
    U, number = np.zeros(controller.plant.m), ctypes.c_double
    for t, X, at, applied, values, expected, refused in calls:
        for name, value in values.items():
            if getattr(library, f"npred_set_{name}")(memory, number(value)) not in TAKEN:
                return math.inf
        if applied is not None:
            library.npred_applied(memory, np.ascontiguousarray(applied).ctypes.data_as(ctypes.c_void_p))
        sample = None if X is None else np.ascontiguousarray(X).ctypes.data_as(ctypes.c_void_p)
        code = library.npred_step_at(
            memory, number(t), sample, number(t if at is None else at), U.ctypes.data_as(ctypes.c_void_p)
        )
        if (code == 0) == refused:
            return math.inf
        if not refused:
            worst = max(worst, float(np.abs(U - expected).max()))
    return worst if math.isfinite(worst) else math.inf


def by_fmu(controller: Any, calls: list[tuple[Any, ...]]) -> float:
    """The largest difference of U of the FMU from that of the same calls in Python."""
    with tempfile.TemporaryDirectory() as folder:
        one, worst = harness.InFmu(controller, Path(folder)), 0.0
        for _, X, _, _, values, expected, refused in calls:
            if values:
                one.set(**values)
            try:
                worst = max(worst, float(np.abs(one.step(X) - expected).max()))
                came = False
            except DivergedError:
                came = True
            if came != refused:
                return math.inf
    return worst if math.isfinite(worst) else math.inf


def _on_time(calls: list[tuple[Any, ...]], dt: float) -> bool:
    steps = enumerate(calls)
    return all(X is not None and at == t and abs(t - k * dt) < 1e-9 and a is None for k, (t, X, at, a, *_) in steps)


def compared(loop: dict[str, Any], ways: list[str]) -> Iterator[tuple[str, float]]:
    """The differences of U between pairs of ways; infinite where a status differs."""
    run: Trajectories = npred.simulate(**loop, progress=False)
    size = np.nanmax(np.abs(run.U - run.U[0]), axis=0) / 2
    bounds = np.array(_bounds(loop), dtype=float)
    half = np.where(np.isfinite(np.ptp(bounds, axis=1)), np.ptp(bounds, axis=1) / 2, np.maximum(size, 1e-6))
    history = loop["actuator"] == "history"
    on_clock = run
    if "pipeline" in ways:
        yield "pipeline", _apart(run.U, by_pipeline(loop), half)
    if history and run.clock is None and "clock" in ways:
        on_clock = npred.simulate(**loop, timing=npred.Timing(), progress=False)
        yield "clock", _apart(run.U, on_clock.U, half)
    if not history or "controller" not in ways or on_clock.clock is None:
        return
    U, counts, start, calls = by_controller(loop)
    seen = {name: int(getattr(on_clock.clock, name)) for name in counts}
    yield "controller", _apart(on_clock.U, U, half) if seen == counts else math.inf
    even = "timing" not in loop or not loop["timing"].jitter  # the rig's plant takes its steps from the samples on
    if "rig" in ways and even and loop["plant"].one_delay and "disturbance" not in loop:
        yield "rig", _apart(U, by_controller(loop, OnRig)[0], half)
    if "c" in ways:
        yield "c", by_c(start, calls)
    if "fmu" in ways and len(calls) == STEPS + 1 and _on_time(calls, loop["dt"]):
        yield "fmu", by_fmu(start, calls)


def _apart(a: np.ndarray, b: np.ndarray, half: np.ndarray) -> float:
    if not (np.isnan(a) == np.isnan(b)).all():
        return math.inf
    return float(np.nanmax(np.abs(a - b) / half, initial=0.0))


def crossed(
    pool: list[tuple[float, dict[str, Any]]], fresh: dict[str, Any], rng: np.random.Generator
) -> dict[str, Any]:
    """A description near one of the worst of its plant so far: parts of a fresh one, the start and D_hat moved."""
    near = [loop for _, loop in pool if loop["plant"] is fresh["plant"] and loop["actuator"] == fresh["actuator"]]
    if not near:
        return fresh
    loop = {**near[int(rng.integers(len(near)))]}
    kept = [name for name in fresh if name in ("plant", "predictor", "dt", "D", "t_end") or rng.random() < 0.8]
    loop = {name: value for name, value in loop.items() if name in fresh or rng.random() < 0.9}
    loop |= {name: value for name, value in fresh.items() if name not in kept}
    if "timing" in loop:  # a pipeline has one seed
        loop["timing"] = replace(loop["timing"], seed=_seed(loop))
    loop["X0"] = loop["X0"] * rng.uniform(0.9, 1.1, len(loop["X0"]))
    return loop if "adaptation" in loop else loop | {"D_hat": loop["D_hat"] * rng.uniform(0.9, 1.1)}


if __name__ == "__main__":
    asked = harness.options(
        __doc__, {}, count=200, first=0, seed=0, ways="clock,pipeline,controller,rig,c,fmu", adversary=False
    )
    worst: dict[str, tuple[float, int]] = {}
    apart, counted, words, ran = (collections.Counter[str]() for _ in range(4))
    pool: list[tuple[float, dict[str, Any]]] = []
    for number in range(asked.first, asked.first + asked.count):
        loop = described(rng := np.random.default_rng([asked.seed, number]))
        loop = crossed(pool, loop, rng) if asked.adversary else loop
        try:
            differences = dict(compared(loop, asked.ways.split(",")))
        except NpredError as error:
            words[str(error)[:90]] += 1
            continue
        ran["descriptions"] += 1
        pool = sorted([*pool, (max(differences.values(), default=0.0), loop)], key=lambda one: -one[0])[:40]
        for way, difference in differences.items():
            worst[way] = max(worst.get(way, (0.0, -1)), (difference, number))
            counted[way] += 1
            if difference > AGREE:
                apart[way] += 1
                parts = {k: v for k, v in loop.items() if k not in ("plant", "predictor", "X0")}
                print(f"{number}: {way} differs by {difference:.2g}: {loop['plant'].name} {parts}", flush=True)
    print(f"{ran['descriptions']} descriptions ran")
    harness.head("way", "loops", f"differ by more than {AGREE:g}", "worst", "in")
    for way, (difference, number) in worst.items():
        harness.row(way, counted[way], apart[way], f"{difference:.2g}", number)
    for text, count in words.most_common():
        print(f"refused {count}: {text}")

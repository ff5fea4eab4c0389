"""Promises of the safety filter: is a loop broken that was promised to keep its limits, and who gets no promise?

    python benchmarks/promises.py random|brake|wrong|adversary [--plant wall …] [--starts 200] [--seconds 60]

The plants are those of limited.py. A promise of a control step is broken where h falls below 0 at or after the time at
which the command of this step acts. The commands that npred gives are integrated once more, by RK4 with FINE steps per
control step; for the plants in SYSTEMS the dynamics and h are written here anew.
- `random`: starts from the box, D known. The loops that are promised at first, how many of these are broken, and their
  least h over the size of h; the loops that a promise of any step is broken in, or withdrawn; `false`: those with an
  `unkept` first step that keep all limits and come to rest; `cries`: those that are promised at first and kept, and
  have an `unkept` step; `well`: those that keep the limits without the filter, for twice the time, and how many of them
  have other U with it; the microseconds of a control step without and with it.
- `brake`: --braked starts from 1.5 times the box that are within the limits when the first command acts. Of those from
  which an optimal control problem of full knowledge (CasADi, IPOPT) keeps 0.1 % of the size and ends at a rest, within
  the bounds of U and with the first U held for a control step: the share that is promised.
- `wrong`: promised and broken with D some control steps off, with an EKF and noise, with calls that jitter.
- `adversary`: CMA-ES chooses the start, the input before t = 0 as steps of equal length, when a set-point moves, and
  where to; it makes the least h of promised loops as small as it can. The worst one is integrated once more.
"""

import math
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import harness
import numpy as np
from limited import Case, cases

import npred
from npred.base.progress import quiet

FINE = 4  # steps of RK4 in a control step
ROUNDING = 1e-9  # of the size of h
REST = 0.02  # of half a box: what a state at rest moves by in the last tenth of the time
SIZE, GENERATIONS, WIDTH = 12, 15, 0.3  # of a population; the spread that it begins with
PIECES = 4  # of the input before t = 0
OUTSIDE, FAR = 10.0, 1e6  # what a candidate that is not promised counts at least, and one that is lost more
JITTER = 0.3  # of a control step: how early or late a call comes
SAME = 1e-4  # of half a box: what a step of RK4 may differ from finer ones by
SPARE, WANTED = 1e-3, 2e-2  # of the size of h: what a brake must keep, and tries to
RESTS = 1e-3  # of half a box, per unit of time: what a state moves by where a brake ends


class System(NamedTuple):
    """f(x, u) and the limits h(x, t), of components."""

    f: Callable[[Any, Any], list[Any]]
    h: Callable[[Any, Any], list[Any]]


def arm(x: Any, u: Any) -> list[Any]:
    """Two rods of 1 kg and 0.5 m, their angles to the vertical, friction 0.1, by Cramer's rule."""
    c, s = 0.125 * np.cos(x[0] - x[1]), 0.125 * np.sin(x[0] - x[1])
    first = u[0] - u[1] - 0.1 * x[2] - s * x[3] ** 2 - 7.3575 * np.sin(x[0])
    second = u[1] - 0.1 * x[3] + s * x[2] ** 2 - 2.4525 * np.sin(x[1])
    whole = 1 / 36 - c**2
    return [x[2], x[3], (first / 12 - c * second) / whole, (second / 3 - c * first) / whole]


def tank(x: Any, u: Any) -> list[Any]:
    """The tank's level and temperature: area 2, feed 0.06 · 15 √(4 - h), outflow 0.9 √h, heat 0.5."""
    feed = 0.9 * np.sqrt(4.0 - x[0])
    return [(feed - 0.9 * np.sqrt(x[0])) / 2.0, feed * (u[0] - x[1]) / (2.0 * x[0]) + 0.5 * x[1]]


def aircraft(x: Any, u: Any) -> list[Any]:
    """The PVTOL with a coupling of 0.5."""
    sin, cos = np.sin(x[2]), np.cos(x[2])
    return [x[3], x[4], x[5], -u[0] * sin + 0.5 * u[1] * cos, u[0] * cos + 0.5 * u[1] * sin - 1, u[1]]


def pole(x: Any, u: Any) -> list[Any]:
    """A cart of 1 kg with 0.2 kg at the end of a rod of 0.4 m, by Cramer's rule on both accelerations."""
    sin, cos = np.sin(x[2]), np.cos(x[2])
    push, weight, whole = u[0] + 0.08 * x[3] ** 2 * sin, 0.08 * 9.81 * sin, 1.2 * 0.032 - (0.08 * cos) ** 2
    return [x[1], (0.032 * push - 0.08 * cos * weight) / whole, x[3], (1.2 * weight - 0.08 * cos * push) / whole]


def crane(x: Any, u: Any) -> list[Any]:
    """A point that hangs 1 m below a trolley: its forces across the rope."""
    return [x[1], u[0], x[3], -(9.81 * np.sin(x[2]) + np.cos(x[2]) * u[0] + 0.1 * x[3])]


SYSTEMS = {
    "wall": System(lambda x, u: [x[1], u[0]], lambda x, t: [5.5 - x[0]]),
    "door": System(lambda x, u: [x[1], u[0]], lambda x, t: [np.where(t < 4.0, 10.0 - 1.2 * t, 5.2) - x[0]]),
    "jerked": System(lambda x, u: [x[1], x[2], u[0]], lambda x, t: [5.5 - x[0]]),
    "pendulum": System(
        lambda x, u: [x[1], u[0] - 9.81 * np.sin(x[0]) - 0.2 * x[1]], lambda x, t: [1.2 - x[1], 1.2 + x[1]]
    ),
    "pole": System(pole, lambda x, t: [0.6 - x[0], 0.6 + x[0]]),
    "aircraft": System(aircraft, lambda x, t: [0.25 - x[2], 0.25 + x[2]]),
    "elbow": System(arm, lambda x, t: [0.85 - x[1], x[1] - 0.2]),
    "tank": System(tank, lambda x, t: [24.0 - x[1], x[1] - 16.0]),
    "crane": System(crane, lambda x, t: [5.1 - x[0], 0.12 - x[2], 0.12 + x[2]]),
    "cubic": System(lambda x, u: [x[0] + 1.5 * x[0] ** 3 + u[0]], lambda x, t: [1.0 - x[0] ** 2]),
}


def rates(case: Case) -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """f(X, u, t) and h(X, t) of states (..., n)."""
    if case.name not in SYSTEMS:
        return case.plant.f, case.plant.safe
    own = SYSTEMS[case.name]

    def first(a: np.ndarray) -> np.ndarray:
        return np.moveaxis(a, -1, 0)

    def rows(parts: list[Any]) -> np.ndarray:
        return np.stack(np.broadcast_arrays(*parts), axis=-1)

    return (lambda X, u, t: rows(own.f(first(X), first(u)))), (lambda X, t: rows(own.h(first(X), t)))


@np.errstate(all="ignore")
def onward(case: Case, Z: np.ndarray, u: np.ndarray, span: Any, count: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """(X, t) a `span` (...) later, in FINE `count` steps of RK4, and the least h on the way over its size."""
    (f, safe), count = rates(case), FINE * count
    h, rooms = np.expand_dims(np.asarray(span) / count, -1), []
    for k in range(count + 1):
        room = safe(Z[..., :-1], Z[..., -1]).min(axis=-1) / case.size
        rooms.append(np.where(np.isnan(room), -np.inf, room))
        if k < count:
            Z = harness.rk4(
                lambda Z: np.concatenate([f(Z[..., :-1], u, Z[..., -1]), np.ones_like(Z[..., :1])], -1), Z, h
            )
    return Z, np.min(rooms, axis=0)


@np.errstate(all="ignore")
def sound(case: Case, Z: np.ndarray, u: np.ndarray, spans: Any) -> np.ndarray:
    """The least h over its size on the way from each (X, t) (..., N + 1, n + 1) to the next, with inputs (..., N, m);
    -inf where finer steps do not lead there.
    """
    ends, least = onward(case, Z[..., :-1, :], u, spans)
    off = np.abs(ends - Z[..., 1:, :])[..., :-1] / harness.half_widths(case.plant)
    return np.where((off < SAME).all(axis=-1), least, -np.inf)


def length(case: Case) -> float:
    """How long a piece of the input before t = 0 lasts: control steps, so many that all pieces cover D."""
    return case.dt * math.ceil(case.D / case.dt / PIECES - 1e-9)


def past(case: Case, before: np.ndarray, t: float) -> np.ndarray:
    """The input at t < 0; before (pieces, m) are its pieces, the last one first."""
    return before[min(int(-t / length(case)), len(before) - 1)]


def replayed(case: Case, loop: Any, D: Any, before: np.ndarray) -> np.ndarray:
    """The least h over its size from the time on at which each command acts, (B, nt): each control step of the loop is
    integrated anew from its state, with the command that was sent D, a number of control steps, earlier.
    """
    late = np.rint(np.broadcast_to(D, len(loop.X)) / case.dt).astype(int)[:, None]
    steps = np.arange(len(loop.t))
    acts = steps[:-1] - late
    early = np.array([past(case, before, (k + 0.5) * case.dt) for k in range(-late.max(), 0)])
    u = np.where((acts < 0)[..., None], early[np.minimum(acts, -1)], np.take_along_axis(loop.U, acts[..., None], 1))
    Z = np.concatenate([loop.X, np.broadcast_to(loop.t[:, None], (*loop.X.shape[:2], 1))], axis=-1)
    least = onwards(sound(case, Z, u, case.dt))
    padded = np.column_stack([least, np.full((len(least), late.max() + 1), np.inf)])
    return np.take_along_axis(padded, steps + late, axis=1)


def onwards(rooms: np.ndarray) -> np.ndarray:
    """The least of each row from each place on."""
    return np.minimum.accumulate(rooms[:, ::-1], axis=1)[:, ::-1]


def recorded(case: Case, loop: Any) -> np.ndarray:
    """The same as `replayed`, of the states of npred's own loop."""
    rooms = np.where(np.isnan(loop.safety), -np.inf, loop.safety).min(axis=-1) / case.size
    late = math.ceil(case.D / case.dt + JITTER - 1e-9)
    return np.column_stack([onwards(rooms)[:, late:], np.full((len(rooms), late), np.inf)])


def loops(case: Case, X0: np.ndarray, safety: Any, t_end: float | None = None, **parts: Any) -> Any:
    named = {"D": case.D, "D_hat": case.D, "dt": case.dt, "u0": case.before, "setpoints": case.moves} | parts
    predictor = npred.predictor(case.plant, "rk4", 31)
    with quiet():
        return npred.simulate(
            case.plant, predictor, X0=X0, t_end=t_end or case.t_end, actuator="history", safety=safety, progress=False,
            **named,
        )  # fmt: skip


def promised(loop: Any, first: Any) -> np.ndarray:
    """Whether a plan was promised at each control step (B, nt); `first` is the loop's first control step."""
    if hasattr(loop, "promised"):
        return loop.promised
    return np.broadcast_to(first.unkept[:, None] == 0, loop.filtered.shape)


@np.errstate(all="ignore")
def rests(case: Case, loop: Any) -> np.ndarray:
    """Whether each loop is at rest over the last tenth of the time (B,)."""
    moved = np.ptp(loop.X[:, -len(loop.t) // 10 :], axis=1)
    return (moved <= REST * harness.half_widths(case.plant)).all(axis=-1)


def random(every: dict[str, Case], asked: Any) -> Iterator[list[Any]]:
    yield ["plant", "promised", "broken", "least h", "at any step: broken", "withdrawn", "false", "cries", "well",
           "other U", "µs"]  # fmt: skip
    for name, case in every.items():
        X0 = harness.starts(case.plant, asked.starts, np.random.default_rng(asked.seed))
        first = loops(case, X0, npred.SafetyFilter(), case.dt)  # compiles, too
        loops(case, X0[:2], None, case.dt)
        plain, free = harness.seconds(lambda case=case, X0=X0: loops(case, X0, None, 2 * case.t_end))
        taken, loop = harness.seconds(lambda case=case, X0=X0: loops(case, X0, npred.SafetyFilter()))
        least, least_free = (replayed(case, one, case.D, case.before[None]) for one in (loop, free))
        P, keeps, well = promised(loop, first), least >= -ROUNDING, least_free[:, 0] >= 0
        kept, at_first = keeps[:, 0], P[:, 0]
        per_step = 1e6 / len(X0) / loop.steps
        yield [
            name, at_first.sum(), (at_first & ~kept).sum(), f"{least[at_first, 0].min(initial=np.inf):.1e}",
            (P & ~keeps).any(axis=1).sum(), (P[:, :-1] & ~P[:, 1:]).any(axis=1).sum(),
            ((first.unkept > 0) & kept & rests(case, loop)).sum(), (at_first & kept & (loop.unkept > 0)).sum(),
            well.sum(), (well & (free.U[:, : loop.U.shape[1]] != loop.U).any(axis=(-2, -1))).sum(),
            f"{plain * per_step / 2:.1f} -> {taken * per_step:.1f}",
        ]  # fmt: skip


# the optimal brake


class OfCasadi:
    """What `M` offers a plant, on CasADi's expressions."""

    names = {"maximum": "fmax", "minimum": "fmin", "abs": "fabs"}

    def __getattr__(self, name: str) -> Any:
        import casadi as ca

        return getattr(ca, self.names.get(name, name))

    @staticmethod
    def solve(A: Any, b: Any) -> list[Any]:
        """The y of A y = b."""
        import casadi as ca

        return ca.vertsplit(ca.solve(ca.vertcat(*(ca.horzcat(*row) for row in A)), ca.vertcat(*b)))


def grid(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """The lengths of a brake's steps (N,), and the piece of the input of each: the first is a control step long."""
    total = case.t_end / 2
    pieces = [case.dt]
    while sum(pieces) < total:
        pieces.append(min(1.2 * pieces[-1], total / 15))
    parts = [math.ceil(piece / max(total / 160, case.dt)) for piece in pieces]
    return np.repeat(np.divide(pieces, parts), parts), np.repeat(np.arange(len(pieces)), parts)


def brake(case: Case) -> Callable[[np.ndarray], bool]:
    """Whether from a state at t = D the limits can be kept until a rest: by multiple shooting and IPOPT."""
    import casadi as ca

    plant, M, (lengths, piece) = case.plant, OfCasadi(), grid(case)
    x, u, t, h = ca.SX.sym("x", plant.n), ca.SX.sym("u", plant.m), ca.SX.sym("t"), ca.SX.sym("h")
    N, times = len(lengths), case.D + np.concatenate([[0.0], np.cumsum(lengths)])
    half = harness.half_widths(plant)

    def f(z: Any) -> Any:
        return ca.vertcat(*plant.call("f", ca.vertsplit(z[:-1]), ca.vertsplit(u), z[-1], plant.p, M), 1.0)

    following = ca.Function(
        "following", [x, u, t, h], [harness.rk4(f, harness.rk4(f, ca.vertcat(x, t), h / 2), h / 2)[:-1]]
    )
    rate = ca.Function("rate", [x, u, t], [f(ca.vertcat(x, t))[:-1] / half])
    room = ca.Function("room", [x, t], [ca.vertcat(*plant.call("safe", ca.vertsplit(x), None, t, plant.p, M))])
    problem = ca.Opti()
    start, missed = problem.parameter(plant.n), problem.variable()
    scaled, U = problem.variable(plant.n, N + 1), problem.variable(plant.m, piece[-1] + 1)
    X, held = ca.repmat(half, 1, N + 1) * scaled, U[:, piece.tolist()]
    problem.subject_to(X[:, 0] == start)
    problem.subject_to(missed >= 0)
    after = following.map(N)(X[:, :-1], held, times[None, :-1], lengths[None])
    problem.subject_to(ca.vec((X[:, 1:] - after) / ca.repmat(half, 1, N)) == 0)
    problem.subject_to(ca.vec(room.map(N + 1)(X, times[None])) / case.size >= WANTED - missed)
    problem.subject_to(problem.bounded(-RESTS, rate(X[:, -1], U[:, -1], times[-1]), RESTS))
    for c, (low, high) in enumerate(case.bounds):
        problem.subject_to(problem.bounded(low, U[c, :], high))
    problem.minimize(
        1e3 * missed + 1e-3 * ca.sumsqr((U - ca.repmat(U[:, -1], 1, U.shape[1])) / np.ptp(case.bounds, axis=1))
    )
    problem.solver(
        "ipopt",
        {"print_time": 0, "show_eval_warnings": False, "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 200}},
    )

    def keeps(state: np.ndarray) -> bool:
        problem.set_value(start, state)
        goal = np.broadcast_to(plant.target(times), (N + 1, plant.n))
        for speed in (5.0, 0.5):
            share = np.exp(-speed * np.arange(N + 1) / N)[:, None]
            problem.set_initial(scaled, ((share * state + (1 - share) * goal) / half).T)
            problem.set_initial(U, np.tile(case.before, (U.shape[1], 1)).T)
            problem.set_initial(missed, 0.5)
            try:
                found = problem.solve()
            except RuntimeError:
                continue
            path, sent = (np.reshape(found.value(a), a.shape) for a in (X, held))
            return sound(case, np.column_stack([path.T, times]), sent.T, lengths).min() >= SPARE
        return False

    return keeps


def braked(every: dict[str, Case], asked: Any) -> Iterator[list[Any]]:
    yield ["plant", "starts", "a brake keeps", "of these promised", "share", "promised, no brake found"]
    for name, case in every.items():
        low, high = harness.box(case.plant) + np.array([[-0.25], [0.25]]) * 2 * harness.half_widths(case.plant)
        X0 = np.random.default_rng(asked.seed).uniform(low, high, (4 * asked.braked, case.plant.n))
        Z = np.column_stack([X0, np.zeros(len(X0))])
        Z = onward(case, Z, np.broadcast_to(case.before, (len(X0), case.plant.m)), case.D, round(case.D / case.dt))[0]
        inside = np.flatnonzero((case.plant.safe(Z[:, :-1], case.D) >= 0).all(axis=-1))[: asked.braked]
        first, keeps = loops(case, X0[inside], npred.SafetyFilter(), case.dt), brake(case)
        has, can = promised(first, first)[:, 0], np.array([keeps(z[:-1]) for z in Z[inside]], dtype=bool)
        both = (has & can).sum()
        yield [name, len(inside), can.sum(), both, f"{both / max(can.sum(), 1):.1%}", (has & ~can).sum()]


# what is not known


def wrong(every: dict[str, Case], asked: Any) -> Iterator[list[Any]]:
    yield ["plant", "D: promised", "broken", "EKF: promised", "broken", "jitter: promised", "broken"]
    for name, case in every.items():
        rng, plant = np.random.default_rng(asked.seed), case.plant
        X0, noise = harness.starts(plant, asked.starts, rng), 1e-3 * harness.half_widths(plant)
        most = round(case.delay / case.dt)
        D = case.D + case.dt * rng.integers(-most, most + 1, len(X0))
        ways = (
            (npred.SafetyFilter(delay=case.delay), {"D": D}),
            (npred.SafetyFilter(margin=0.02 * case.size), {
                "observer": npred.observers.EKF(plant, R=noise**2, outputs=plant.states),
                "measurement": npred.Measurement(noise=noise),
            }),
            (npred.SafetyFilter(margin=0.02 * case.size), {"timing": npred.Timing(jitter=JITTER)}),
        )  # fmt: skip
        line = [name]
        for safety, parts in ways:
            loop, first = (loops(case, X0, safety, t_end, **parts) for t_end in (None, case.dt))
            exact = "D" in parts
            least = replayed(case, loop, D, case.before[None]) if exact else recorded(case, loop)
            P = promised(loop, first)
            line += [P.any(axis=1).sum(), (P & (least < -ROUNDING)).any(axis=1).sum()]
        yield line


# the adversary


def candidate(case: Case, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, Any]:
    """The start (1, n), the input before t = 0 (PIECES, m) and the set-points that z in [0, 1]^k stands for."""
    n, (least, most) = case.plant.n, harness.box(case.plant)
    low, high = case.bounds.T
    before, moves = low + z[n:-2].reshape(PIECES, -1) * (high - low), case.moves
    if case.aim:
        name, low, high = case.aim
        moves = {name: ([0.6 * z[-2] * case.t_end], [low + z[-1] * (high - low)])}
    return (least + z[:n] * (most - least))[None], before, moves


def tried(case: Case, z: np.ndarray) -> tuple[float, Any, int]:
    """The least h over its size from the first promise on, the loop, that step; else how far h is from a promise."""
    X0, before, moves = candidate(case, z)
    parts = {"u0": lambda t: past(case, before, t), "setpoints": moves}
    loop, first = (loops(case, X0, npred.SafetyFilter(), t_end, **parts) for t_end in (None, case.dt))
    least, P = np.maximum(recorded(case, loop), -FAR), promised(loop, first)[0]
    return (least[0, P.argmax()], loop, P.argmax()) if P.any() else (OUTSIDE - min(least[0, 0], 0.0), None, 0)


def search(case: Case, seconds: float, seed: int) -> list[Any]:
    """Populations from random centres until the time is over: the loops, those promised, broken, and the worst."""
    rng, ends, values = np.random.default_rng(seed), time.monotonic() + seconds, []
    size, worst = case.plant.n + PIECES * case.plant.m + 2, (np.inf, np.zeros(0))

    def scores(points: list[np.ndarray]) -> list[float]:
        nonlocal worst
        found = [tried(case, z)[0] for z in points]
        values.extend(found)
        worst = min(worst, *zip(found, points, strict=True), key=lambda pair: pair[0])
        return found

    while time.monotonic() < ends:
        begins = int(rng.integers(1, 2**31)), rng.uniform(0.2, 0.8, size)
        for k, stops in enumerate(harness.evolve(scores, begins[1], WIDTH, SIZE, begins[0]), start=1):
            if k == GENERATIONS or stops or time.monotonic() > ends:
                break
    (_, loop, begin), (_, before, _) = tried(case, worst[1]), candidate(case, worst[1])
    again = np.inf if loop is None else replayed(case, loop, case.D, before)[0, begin]
    found = np.array(values)
    promises, broken = found < OUTSIDE, (found < -ROUNDING).sum()
    return [len(found), promises.sum(), broken, f"{worst[0]:.1e}", f"{again:.1e}", worst[1].round(4).tolist()]


def adversary(every: dict[str, Case], asked: Any) -> Iterator[list[Any]]:
    yield ["plant", "loops", "promised", "broken", "least h", "once more", "at"]
    for name, case in every.items():
        yield [name, *search(case, asked.seconds, asked.seed)]


def table(lines: Iterator[list[Any]]) -> None:
    """Print the names of a part's columns, its lines as they come, and the sums of what is counted."""
    names, sums = next(lines), {}
    harness.head(*names)
    for line in lines:
        harness.row(*line)
        for k, cell in enumerate(line):
            if isinstance(cell, int | np.integer):
                sums[k] = sums.get(k, 0) + int(cell)
    harness.row("all", *(sums.get(k, "") for k in range(1, len(names))))


PARTS = {"random": random, "brake": braked, "wrong": wrong, "adversary": adversary}

if __name__ == "__main__":
    numbers = {"starts": 200, "braked": 60, "seconds": 60.0, "seed": 0}
    asked = harness.options(__doc__, {"parts": PARTS}, plant=cases(), **numbers)
    every = {name: case for name, case in cases().items() if name in asked.plant}
    for part in asked.parts:
        table(PARTS[part](every, asked))

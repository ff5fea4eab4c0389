"""The material of a design: f on a tape, the point or the reference that it leads to, and sizes by the box."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from npred.base import randomness, source_lines
from npred.base.errors import ConfigError
from npred.formulas import Value, programs
from npred.formulas.tape import M, Symbol, Vector, names
from npred.formulas.trace import Trace, python
from npred.plants import inputs, newton
from npred.plants.base import Plant, require

SAMPLES = 256  # states of the box
SPAN, MOMENTS = 100.0, 64  # times the box over the speed of a reference without a period, and times in that
STEPS = 100  # of the way to the nearest point of rest
STARTS, ROUGH, NEAR, DECIMALS = 16, 1e-3, 1e-7, 6  # for the search of the nearest, in half widths of the box
MATCHED = 1e-6  # share of the largest rate that may be out of reach of the inputs
ZERO = 1e-9  # share of a derivative's size over the box: below it an input does not act
SLOW = 1e-6  # share of the derivatives' size: rates below are those of integrators, which rounding moves off 0


class Design:
    """A plant as a law is designed for it; its own kappa, if it has one, is not looked at.

    It is to rest at `guess`, where an input holds it there, else at a point of rest near it; at the rest of `setpoint`,
    or along `reference`, where it declares one of them. Raises ConfigError for a plant that is not traced, that has no
    such point, or whose f depends on time without a reference.
    """

    def __init__(self, plant: Plant, law: str) -> None:
        require(plant)
        self.plant, self.law = plant, law
        if not plant.traced:
            raise self.refusal("a plant that is traced, got traced = False", "write kappa(X, t, p) in its class")
        self.follows = getattr(plant.declaration, "reference", None) is not None
        if not (self.follows or plant.autonomous):
            raise self.refusal("an f free of time or a reference(t, p, M), found neither", "declare one")
        self.trace = Trace(plant)
        self.x, self.u, self.t = self.trace.symbols()

    def refusal(self, expected: str, cure: str) -> ConfigError:
        """The error of a law that does not serve the plant, in one line."""
        return ConfigError(f"kappa {self.law}: plant {self.plant.name}: expected {expected}; {cure}")

    def values(self, outputs: Vector, X: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Expressions of x, t and the parameters at states X (B, n) and times t (B,), u being 0: (B, outputs)."""
        n, m, p = self.plant.n, self.plant.m, self.plant.p
        function = python(outputs, [*names("x", n), *names("u", m), "t", *names("p", len(p))])
        with np.errstate(all="ignore"):
            columns = function(*X.T, *np.zeros((m, len(X))), t, *p)
        return np.stack([np.broadcast_to(column, t.shape) for column in columns], axis=-1).astype(float)

    @cached_property
    def rest(self) -> tuple[np.ndarray, np.ndarray]:
        """X and u with f(X, u) = 0, (n,) and (m,): that of a set-point, else X nearest to `guess` in half widths of the
        box.

        Another one may be nearer where none of STARTS searches, from as near to `guess` as the first point found, leads
        there. X is kept to DECIMALS of those widths: more would differ between libraries of linear algebra.
        """
        plant, n = self.plant, self.plant.n
        low, high = self.limits.T
        if plant.declares_setpoint:
            return self._held(plant.p[-n - plant.m : -plant.m], plant.p[-plant.m :])
        start = np.concatenate([plant.guess, np.clip(0.0, low, high)])
        z, arrived = self._onto(start)
        if not arrived or self._distance(z) > 0:
            near, draws = ([self._nearer(z)] if arrived else []), randomness.generator(0, "rest")
            start[n:] = z[n:] if arrived else start[n:]
            for _ in range(STARTS):
                reach = min(map(self._distance, near), default=np.sqrt(n))
                way = draws.standard_normal(n)
                start[:n] = plant.guess + reach * draws.uniform() ** (1 / n) * way / np.linalg.norm(way) * self.widths
                other, arrived = self._search(start)
                near += [self._nearer(other)] if arrived else []
            if not near:
                left = source_lines.values([f"{name}'" for name in plant.states], plant.f(z[:n], z[n:]))
                expected = f"a point of rest near guess = {plant.guess.tolist()}, {left} is left"
                raise self.refusal(expected, "move guess")
            z = self._nearer(min(near, key=self._distance), NEAR)
            z[:n] = np.round(z[:n] / self.widths, DECIMALS) * self.widths + 0.0
            z, _ = self._onto(z)
        return self._held(z[:n], z[n:])

    def _held(self, X: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """X, u. Raises ConfigError for an input that is out of its bounds."""
        if (u < self.limits[:, 0]).any() or (u > self.limits[:, 1]).any():
            values = source_lines.values(self.plant.inputs, u)
            raise self.refusal(f"an input within input_bounds at rest, got {values}", "move guess, or the set-point")
        return X, u

    @property
    def guess(self) -> tuple[float, ...]:
        """Where the equilibrium of the law's loop is searched from: the point of rest; of a reference, `guess`."""
        return tuple((self.plant.guess if self.follows else self.rest[0]).tolist())

    def _distance(self, z: np.ndarray) -> float:
        """How far X of z is from `guess`, in half widths of the box."""
        return float(np.linalg.norm((z[: self.plant.n] - self.plant.guess) / self.widths))

    def _nearer(self, z: np.ndarray, last: float = ROUGH) -> np.ndarray:
        """From a point of rest z to the nearest to `guess` around it: down the gradient along those of the
        linearisation, and back onto those of f, until a step is as short as `last`.
        """
        n, units = self.plant.n, np.concatenate([self.widths, np.ones(self.plant.m)])
        for _ in range(STEPS):
            jacobian = np.hstack(self.plant.jacobians(z[:n], z[n:])) * units
            if not np.isfinite(jacobian).all():
                break
            _, sizes, rows = np.linalg.svd(jacobian)
            free = rows[np.count_nonzero(sizes > ZERO * sizes[0]) :].T
            away = (z[:n] - self.plant.guess) / self.widths
            step = free @ np.linalg.lstsq(free[:n], -away, rcond=ZERO)[0]
            length, share = np.linalg.norm(step[:n]), 1.0
            while share * length > last:
                moved, arrived = self._search(z + share * units * step)
                if arrived and self._distance(moved) ** 2 < away @ away - share * length**2 / 10:
                    break
                share /= 2
            if share * length <= last:
                break
            z = moved
        return z

    def _onto(self, z: np.ndarray) -> tuple[np.ndarray, bool]:
        """A point of rest near z: by u alone where that leads to one, else by X and u, from the u with the least f."""
        moved, arrived = self._search(z, by_input=True)
        if arrived:
            return moved, arrived
        X, u = np.split(z, [self.plant.n])
        change = newton.best_input(self.plant.f(X, u), self.plant.jacobians(X, u)[1], self.plant.scales[: self.plant.n])
        return self._search(np.append(X, u + change))

    def _search(self, z: np.ndarray, by_input: bool = False) -> tuple[np.ndarray, bool]:
        """A point of rest from z on by X and u in one vector, or by u alone, by the shortest steps in their sizes."""
        n, plant = self.plant.n, self.plant

        def F(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return plant.f(z[:n], z[n:]), np.hstack(plant.jacobians(z[:n], z[n:]))

        units = plant.scales * np.append(np.full(n, not by_input), np.ones(plant.m))
        return newton.search(F, z, units)

    @cached_property
    def target(self) -> tuple[Sequence[Value], Sequence[Value]]:
        """State and input to lead to, as numbers, as expressions of t, or as the parameters that are a set-point's.

        The input of a reference is the one with which f is its derivative, by least squares where f has more rows.
        """
        if self.plant.declares_setpoint:
            rest = self.trace.parameters[-self.plant.n - self.plant.m :]
            return rest[: self.plant.n], rest[self.plant.n :]
        if not self.follows:
            X, u = self.rest
            return X.tolist(), u.tolist()
        X = self.trace.reference(self.t)
        rate = programs.derivative(X, [self.t], [1.0])
        B = self._by_input(X)
        drift = self.trace.f(X, np.zeros(self.plant.m), self.t)
        return list(X), solved(B, [a - b for a, b in zip(rate, drift, strict=True)])

    @cached_property
    def B(self) -> np.ndarray:
        """f_U (n, m) as expressions. Raises ConfigError for an f that is not affine in the inputs."""
        return self._by_input(self.x)

    def _by_input(self, X: np.ndarray) -> np.ndarray:
        f = self.trace.f(X, self.u, self.t)
        columns = [programs.derivative(f, self.u, unit) for unit in np.eye(self.plant.m)]
        if programs.depends([a for column in columns for a in column], self.u):
            raise self.refusal("an f that is affine in the inputs, got another", "take lqr, or write kappa(x, t, p, M)")
        return np.array(columns, dtype=object).T

    @cached_property
    def moments(self) -> np.ndarray:
        """Times of a period of a reference, or of SPAN, (MOMENTS,); 0 for a point of rest."""
        if not self.follows:
            return np.zeros(1)
        end = self.plant.period
        if end is None:  # as long as f at its start would take to cross the box SPAN times
            X, u = (self.values(part, np.zeros((1, self.plant.n)), np.zeros(1))[0] for part in self.target)
            speed = np.abs(self.plant.f(X, u) / self.widths).max()
            end = SPAN / speed if speed > 0 else SPAN
        return np.linspace(0.0, end, MOMENTS, endpoint=False)

    @cached_property
    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """States and inputs to lead to at `moments`: (T, n) and (T, m)."""
        X, u = self.target
        z = self.values([*X, *u], np.zeros((len(self.moments), self.plant.n)), self.moments)
        return z[:, : self.plant.n], z[:, self.plant.n :]

    @cached_property
    def slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """f_X (T, n, n) and f_U (T, n, m) at `moments` of the target."""
        return self.plant.jacobians(*self.targets, self.moments)

    def schedules(self, closed: np.ndarray) -> bool:
        """Whether some K(t) makes A(t) - B(t) K(t) = closed, (n, n), along the reference.

        None does where a difference of the rates is not in the range of B(t), or where a state of the reference is a
        number, or is equal to another one.
        """
        A, B = self.slopes
        excess = A - closed
        left = excess - B @ np.linalg.pinv(B) @ excess
        symbols = {x.index for x in self.target[0] if isinstance(x, Symbol)}
        return len(symbols) == self.plant.n and bool(np.abs(left).max() <= MATCHED * np.abs(A).max())

    def scheduled(self, closed: np.ndarray, error: Sequence[Value]) -> list[Value]:
        """K(t) e, as expressions, where K(t) makes A(t) - B(t) K(t) = closed: the error obeys e' = closed e."""
        X, u = self.target
        rates = self.trace.f(np.array(X, dtype=object), np.array(u, dtype=object), self.t)
        held = [a for a in u if isinstance(a, Symbol)]  # u is an expression of X, but no part of f_X
        by_error = programs.derivative(rates, [*X, *held], [*error, *[0.0] * len(held)])
        goals = [_dot(row, error) for row in closed]
        return solved(self._by_input(np.array(X, dtype=object)), [a - b for a, b in zip(by_error, goals, strict=True)])

    @cached_property
    def linearised(self) -> tuple[np.ndarray, np.ndarray]:
        """f_X and f_U, (n, n) and (n, m), at the point of rest, or their means along the reference."""
        A, B = (part.mean(axis=0) for part in self.slopes)
        if not (np.isfinite(A).all() and np.isfinite(B).all()):
            raise self.refusal("derivatives of f where the law leads, got none", "move guess")
        return A, B

    @cached_property
    def widths(self) -> np.ndarray:
        """Half the box, (n,), where that has a width, else 1."""
        width = np.ptp(self.plant.ranges(), axis=1) / 2
        return np.where(width > 0, width, 1.0)

    @cached_property
    def samples(self) -> np.ndarray:
        """States of the box, (SAMPLES, n)."""
        return self.plant.drawn("laws", SAMPLES)

    @cached_property
    def sizes(self) -> np.ndarray:
        """A size of each input, (m,): how far it may move to the nearer of its bounds, but no more than this.

        With so much of it a state crosses half its box within the time constant of the plant's fastest rate: so a loop
        is about as fast as its plant, however strong its motors are. Where all rates are 0, that of its derivatives, as
        states that cross their half boxes move others; where these are 0 too, as of x' = u, nothing says what is fast,
        and it is 1 of the unit of time.
        """
        u = self.targets[1][0]
        room = np.abs(self.limits - u[:, None]).min(axis=1)
        A, B = self.linearised
        rate, moved = np.abs(np.linalg.eigvals(A)).max(), np.abs(A * self.widths / self.widths[:, None]).max()
        crossings = np.abs(B / self.widths[:, None]).max(axis=0)
        free = (rate if rate > SLOW * moved else moved or 1.0) / np.where(crossings > 0, crossings, 1.0)
        return np.where(room > 0, np.minimum(room, free), free)

    @cached_property
    def limits(self) -> np.ndarray:
        """The plant's input bounds, (m, 2)."""
        return inputs.bounds(self.plant, None)


def acts(forces: np.ndarray, drift: np.ndarray) -> bool:
    """True if an input moves a derivative, by the values `forces` (B, m), whose value is `drift` (B,) without.

    A tape does not see that x - x + u - u is 0, nor that a parameter is.
    """
    finite = np.isfinite(forces).all(axis=-1) & np.isfinite(drift)
    most, other = (np.abs(part[finite]).max(initial=0.0) for part in (forces, drift))
    return bool(most > ZERO * max(most, other, np.finfo(float).tiny))


def solved(B: np.ndarray, right: Sequence[Value]) -> list[Value]:
    """u (m,) that minimises |B u - right|, B (k, m) of full rank, by expressions."""
    columns = B.T
    normal = [[_dot(a, b) for b in columns] for a in columns]
    return M.solve(normal, [_dot(a, right) for a in columns])


def _dot(a: Vector, b: Vector) -> Value:
    total: Value = 0.0
    for left, right in zip(a, b, strict=True):
        total = total + left * right
    return total

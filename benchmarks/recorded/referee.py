"""A second opinion on the recordings of logs.toml, by SciPy alone: it shares nothing with npred but plants.py.

    python benchmarks/recorded/referee.py DATA_FOLDER [NAME...] [--points 13]

For each delay on a grid, below zero too, parameters and first state are fitted to the first three quarters (output
error, several starts). Printed are the best delay of each input, the range that its profile and a bootstrap of blocks
allow, the same beside a first-order lag of the inputs, and what the model and its rivals err by, simulated, on the last
quarter: rms, in standard deviations of the outputs. A person writes the answer into logs.toml, by what the source says
too.
"""

import argparse
import json
import tomllib
from itertools import accumulate
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import plants
import scipy.io
from pyulog import ULog
from scipy.optimize import least_squares
from scipy.signal import lfilter

SECONDS = {"ms": 1e-3, "s": 1.0, "h": 3600.0}
MOST, MOST_RUNS = 2500, 30  # rows and runs that are used; `rows` of a log names others: begin, end, step
Run = tuple[np.ndarray, np.ndarray, np.ndarray]  # t (n,), U (n, m), Y (n, p)


def tables(path: Path) -> list[dict[str, np.ndarray]]:
    """Every run of a file, arrays by name: `x[1]` is a matrix's second column, "2" a table's without a header."""
    if path.suffix == ".mat":
        table = {}
        for key, value in scipy.io.loadmat(path).items():
            if isinstance(value, np.ndarray) and value.size > 20:
                long = value if value.shape[0] > value.shape[1] else value.T
                table |= {key: long[:, 0]} if long.shape[1] == 1 else {f"{key}[{j}]": c for j, c in enumerate(long.T)}
        return [table]
    if path.suffix == ".json":
        return [{k: np.array(v) for k, v in run.items()} for run in json.loads(path.read_text())["data"]]
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    named = "[" not in lines[0] and any(c.isalpha() and c not in "eE" for c in lines[0])
    cells = [line.split(",") if "," in line else line.split() for line in lines[named:] if not set("[]") & set(line)]
    names = lines[0].split(",") if named else map(str, range(1, len(cells[0]) + 1))
    frame = pd.DataFrame(cells).rename(columns=dict(enumerate(c.strip(' "') for c in names)))
    return [{str(k): pd.to_numeric(v, errors="coerce").to_numpy() for k, v in frame.items()}]


def read(folder: Path, log: dict[str, Any], plant: Any) -> list[Run]:
    """The runs, in the plant's unit of time."""
    given = log.get("columns", {})
    outputs = getattr(plant, "outputs", plant.states)
    outputs = [name for name in outputs if name in given] or outputs  # a state without a column is not measured
    columns, m = [given.get(name, name) for name in (*plant.inputs, *outputs)], len(plant.inputs)
    paths = [Path(folder, log["repository"].replace("/", "+"), path) for path in np.atleast_1d(log["path"])]
    if paths[0].suffix == ".ulg":
        topics = {
            f"{d.name}.{k}": (d.data["timestamp"], v) for d in ULog(str(paths[0])).data_list for k, v in d.data.items()
        }
        t = topics[columns[-1]][0]
        held = [topics[c][1][np.maximum(np.searchsorted(topics[c][0], t, side="right") - 1, 0)] for c in columns]
        return [((t - t[0]) * 1e-6, np.stack(held[:m], 1), np.stack(held[m:], 1))]
    tabs, runs = [table for path in paths for table in tables(path)], []
    if len(paths) > 1:
        tabs = [{k: np.concatenate([table[k] for table in tabs]) for k in tabs[0]}]
    for table in tabs:
        rows = np.stack([table[c].astype(float) for c in columns], 1)
        stamp = log.get("time") or next((c for c in table if c.lower() in ("t", "time")), None)
        t = table[stamp].astype(float) if stamp else np.arange(len(rows)) * log.get("period", 1.0)
        unit = log.get("time_unit", "ms" if stamp == "time_ms" else None)
        t = t * SECONDS[unit] / SECONDS[getattr(plant, "time_unit", "s")] if unit else t
        good = np.isfinite(t) & np.isfinite(rows).all(1)
        t, rows = t[good], rows[good]
        t, later = t - t[0], np.r_[True, np.diff(np.maximum.accumulate(t)) > 0]
        runs.append((t[later], rows[later, :m], rows[later, m:]))
    return runs


def recursion(a: np.ndarray, b: np.ndarray, z0: complex) -> np.ndarray:
    """z with z[k+1] = a[k] z[k] + b[k]."""
    if np.allclose(a, a[0], rtol=1e-9, atol=0):
        return np.r_[z0, lfilter([1], [1, -a[0]], b.astype(complex), zi=[a[0] * z0])[0]]
    return np.array(
        list(accumulate(zip(a.tolist(), b.tolist(), strict=True), lambda z, s: s[0] * z + s[1], initial=z0))
    )


class Model:
    """A plant with delayed inputs, held or drawn linearly, and, if asked for, a first-order lag of each."""

    def __init__(self, plant: Any, free: list[str], lag: bool, linear: bool) -> None:
        self.plant, self.free, self.lag, self.linear = plant, free, lag, linear
        self.start = np.array([plant.parameters[k] for k in free] + [1.0] * lag)
        self.n, self.last = len(plant.states), (b"", None)
        self.guess = np.array(getattr(plant, "guess", np.zeros(self.n)), float)

    def named(self, theta: np.ndarray) -> SimpleNamespace:
        return SimpleNamespace(**{**self.plant.parameters, **dict(zip(self.free, theta, strict=False))})

    def rate(self, x: np.ndarray, u: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """x' at the delayed command u."""
        n, arrived = self.n, x[self.n :] if self.lag else u
        fields = [SimpleNamespace(**dict(zip(names, v, strict=True))) for names, v in
                  ((self.plant.states, x[:n]), (self.plant.inputs, arrived))]  # fmt: skip
        dx = np.array(self.plant.f(*fields, 0.0, self.named(theta), np), float)
        return np.r_[dx, (u - arrived) / max(abs(theta[-1]), 1e-9)] if self.lag else dx

    def outputs(self, X: np.ndarray, theta: np.ndarray) -> np.ndarray:
        if not hasattr(self.plant, "outputs"):
            return X[:, : self.n]
        fields = SimpleNamespace(**dict(zip(self.plant.states, X.T, strict=False)))
        return np.stack(self.plant.output(fields, 0.0, self.named(theta), np), 1)

    def states(self, theta: np.ndarray, x0: np.ndarray, t: np.ndarray, U: np.ndarray, delays: np.ndarray) -> np.ndarray:
        """(n, states) at t: exact where f is affine, else by RK4 from change to change of a command."""
        grid = np.unique(np.r_[t, *(t + d for d in delays)])
        grid = grid[(grid >= t[0]) & (grid <= t[-1])]
        h, value, slope = np.diff(grid), np.empty((len(grid) - 1, U.shape[1])), np.zeros((len(grid) - 1, U.shape[1]))
        for j, d in enumerate(delays):
            if self.linear:
                drawn = np.interp(grid, t + d, U[:, j])
                value[:, j], slope[:, j] = drawn[:-1], np.diff(drawn) / h
            else:
                value[:, j] = U[np.clip(np.searchsorted(t + d, grid[:-1] + h / 2) - 1, 0, len(t) - 1), j]
        x0 = np.r_[x0, value[0]] if self.lag else np.asarray(x0, float)
        B, c, affine, lam, V, W = self.parts(theta, len(x0), U.shape[1])
        index = np.searchsorted(grid, t)
        if affine:
            with np.errstate(all="ignore"):
                step, e = np.outer(h, lam), np.exp(np.outer(h, lam))
                one = np.where(abs(step) < 1e-6, h[:, None], (e - 1) / lam)
                two = np.where(abs(step) < 1e-6, h[:, None] ** 2 / 2, (one - h[:, None]) / lam)
                drive = ((value @ B.T + c) @ W.T * one + slope @ B.T @ W.T * two) * np.exp(
                    np.outer(np.repeat(t[1:], np.diff(index)) - grid[1:], lam)
                )
                drive = np.add.reduceat(drive, index[:-1])
                z0 = W @ x0.astype(complex)
                Z = np.stack([recursion(np.exp(lam[i] * np.diff(t)), drive[:, i], z0[i]) for i in range(len(x0))], 1)
                return np.nan_to_num((Z @ V.T).real, nan=1e9, posinf=1e9, neginf=-1e9)
        X, steps = [x0], max(1, int(np.ceil(h.max() * np.abs(lam).max() / 0.5)))
        for k, d in enumerate(h / steps):
            x = X[-1]
            for i in range(steps):
                u0, u1, u2 = (value[k] + slope[k] * d * (i + s) for s in (0, 0.5, 1))
                k1 = self.rate(x, u0, theta)
                k2 = self.rate(x + d / 2 * k1, u1, theta)
                k3 = self.rate(x + d / 2 * k2, u1, theta)
                x = np.clip(x + d / 6 * (k1 + 2 * k2 + 2 * k3 + self.rate(x + d * k3, u2, theta)), -1e9, 1e9)
            X.append(x)
        return np.array(X)[index]

    def parts(self, theta: np.ndarray, n: int, m: int) -> Any:
        """B and c of x' = A x + B u + c at the guess, whether f is that everywhere, and A's eigenvalues and vectors."""
        if self.last[0] != theta.tobytes():
            base, rng = np.r_[self.guess, np.zeros(n - self.n)], np.random.default_rng(0)
            c = self.rate(base, np.zeros(m), theta)
            A = np.stack([(self.rate(base + 1e-3 * e, np.zeros(m), theta) - c) / 1e-3 for e in np.eye(n)], 1)
            B = np.stack([self.rate(base, e, theta) - c for e in np.eye(m)], 1)
            x, u = rng.normal(size=n) * 0.3, rng.normal(size=m)
            expected = A @ x + B @ u + c
            affine = np.allclose(self.rate(base + x, u, theta), expected, rtol=1e-5, atol=1e-6 * abs(expected).max())
            lam, V = np.linalg.eig(A + 1e-9 * np.triu(np.ones_like(A), 1) * abs(A).max())  # two equal ones are parted
            self.last = theta.tobytes(), (B, c - A @ base, affine, lam, V, np.linalg.inv(V))
        return self.last[1]


class Trial:
    """The fits of one model: three quarters of a run, or of several runs, to fit, and the rest to judge."""

    def __init__(self, model: Model, runs: list[Run]) -> None:
        self.model, self.runs, self.several = model, runs, len(runs) > 1
        parts = [np.arange(len(t)) < 0.75 * len(t) for t, _, _ in runs]
        if self.several:
            parts = [np.full(len(t), k < 0.75 * len(runs)) for k, (t, _, _) in enumerate(runs)]
        self.fitted = np.concatenate(parts)
        self.scale = np.maximum(np.concatenate([Y for _, _, Y in runs]).std(0), 1e-12)
        self.unit = np.where(model.start == 0, 1.0, model.start)

    def first(self, Y: np.ndarray) -> np.ndarray:
        x0, k = self.model.guess.copy(), min(self.model.n, Y.shape[1])
        if self.model.plant.__name__ not in ("Arm", "Tanks"):  # where the first output is no state
            x0[:k] = Y[0, :k]
        return x0

    def residuals(self, z: np.ndarray, delays: np.ndarray) -> np.ndarray:
        theta, rows = z[: len(self.unit)] * self.unit, []
        for t, U, Y in self.runs:
            x0 = self.first(Y) if self.several else z[len(self.unit) :]
            y = self.model.outputs(self.model.states(theta, x0, t, U, delays), theta)
            rows.append(np.clip((y[:, : Y.shape[1]] - Y) / self.scale, -1e6, 1e6))
        return np.concatenate(rows)

    def fit(self, delays: np.ndarray, starts: list[np.ndarray]) -> Any:
        """The best of the fits from several starts."""

        def cost(z: np.ndarray) -> np.ndarray:
            return self.residuals(z, delays)[self.fitted].ravel()

        return min((least_squares(cost, z, x_scale="jac", max_nfev=25) for z in starts), key=lambda found: found.cost)

    def profile(self, longest: float, points: int, period: float) -> tuple[np.ndarray, np.ndarray, list[list[float]]]:
        """Best delays, best parameters, and for each input the ends of its range; one input after the other, twice."""
        m, k, rng = self.runs[0][1].shape[1], len(self.unit), np.random.default_rng(1)
        if self.model.lag:
            self.unit[-1] = longest / 5
        z0 = np.r_[self.model.start / self.unit, [] if self.several else self.first(self.runs[0][2])]
        z0[k - 1] = 1.0 if self.model.lag else z0[k - 1]
        best, ranges = np.full(m, longest / 8), []
        z = self.fit(best, [z0, *(np.r_[z0[:k] * np.exp(rng.normal(size=k) * s), z0[k:]] for s in (0.5, 1, 1, 2))]).x
        for j in [*range(m)] * min(m, 2):
            fits: dict[float, Any] = {}
            grid = np.unique(np.r_[np.linspace(-min(longest / 4, 5 * period), longest, points), 0.0])
            for starts in ([z0], []):
                for d in grid:
                    fits[d] = self.fit(np.r_[best[:j], d, best[j + 1 :]], [z, *starts])
                    z = fits[d].x
                best[j] = min(fits, key=lambda d: fits[d].cost)
                z, step = fits[best[j]].x, np.diff(grid).max()
                grid = np.setdiff1d(np.linspace(best[j] - step, best[j] + step, 13), grid)
            delays = np.sort(list(fits))
            R = [self.residuals(fits[d].x, np.r_[best[:j], d, best[j + 1 :]])[self.fitted] for d in delays]
            ranges.append(interval(delays, R))
        return best, z, ranges[-m:]

    def errors(self, z: np.ndarray, delays: np.ndarray) -> str:
        """Rms of the fit and of the part held back."""
        r = self.residuals(z, delays)
        return " and ".join(f"{np.sqrt((r[rows] ** 2).mean()):.3g}" for rows in (self.fitted, ~self.fitted))


def interval(delays: np.ndarray, R: list[np.ndarray]) -> list[float]:
    """Ends of the profile, with as many samples as the residuals' correlation leaves, and of a bootstrap of blocks."""
    S = np.array([(r**2).sum() for r in R])
    r = R[S.argmin()][:, 0] - R[S.argmin()][:, 0].mean()
    rho = np.array([(r[k:] * r[: len(r) - k]).sum() for k in range(min(len(r) // 4, 400))]) / (r**2).sum()
    length = max(1.0, 1 + 2 * rho[1 : int(np.argmax(rho < 0.05)) or len(rho)].sum())
    allowed = delays[len(r) / length * np.log(S / S.min()) <= 3.84]
    block = max(1, int(min(2 * length, len(r) / 8)))
    sums = np.array([np.add.reduceat((r**2).sum(1), np.arange(0, len(r), block)) for r in R])
    drawn = delays[(np.random.default_rng(2).exponential(size=(400, sums.shape[1])) @ sums.T).argmin(1)]
    return [allowed.min(), allowed.max(), *np.quantile(drawn, [0.025, 0.975])]


def rivals(t: np.ndarray, U: np.ndarray, Y: np.ndarray) -> dict[str, float]:
    """What a constant, a static gain and ARX models, simulated, err by on the last quarter."""
    y, cut, L = Y[:, 0], int(0.75 * len(t)), np.c_[U, np.ones(len(t))]
    guesses = {"constant": np.full(len(t), y[:cut].mean()), "static": L @ np.linalg.lstsq(L[:cut], y[:cut])[0]}
    for n in (2, 4):
        past = np.stack([np.r_[np.full(i, y[0]), y[: len(y) - i]] for i in range(1, n + 1)], 1)
        inputs = np.concatenate([np.r_[np.repeat(U[:1], i, 0), U[: len(U) - i]] for i in range(3 * n)], 1)
        w = np.linalg.lstsq(np.c_[past, inputs, np.ones(len(t))][:cut], y[:cut])[0]
        simulated, drive = list(y[:n]), inputs @ w[n:-1] + w[-1]
        for k in range(n, len(y)):
            simulated.append(float(np.clip(np.dot(simulated[: -n - 1 : -1], w[:n]) + drive[k], -1e6, 1e6)))
        guesses[f"ARX({n})"] = np.array(simulated)
    return {name: float(np.sqrt(((guess - y)[cut:] ** 2).mean()) / y.std()) for name, guess in guesses.items()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--points", type=int, default=13)
    options = parser.parse_args()
    logs = tomllib.loads(Path(__file__).with_name("logs.toml").read_text(encoding="utf-8"))
    for name in options.names or logs:
        log, plant = logs[name], getattr(plants, logs[name]["plant"])
        runs = read(options.folder, log, plant)
        rows = slice(*log.get("rows", (0, MOST, 1)))
        runs = [(t[rows] - t[rows][0], U[rows], Y[rows]) for t, U, Y in runs][:: 1 + len(runs) // MOST_RUNS]
        errors = ", ".join(f"{k} {v:.3g}" for k, v in rivals(*max(runs, key=lambda run: len(run[0]))).items())
        print(f"\n{name}: {len(runs)} runs, {sum(len(t) for t, _, _ in runs)} rows; held back: {errors}")
        for label, lag, linear in (("held", False, False), ("linear", False, True), ("lag", True, False)):
            trial = Trial(Model(plant, log["free"], lag, linear), runs)
            D, z, ranges = trial.profile(log["longest"], options.points, float(np.median(np.diff(runs[0][0]))))
            ends = "; ".join(
                "{:.4g} [{:.4g}, {:.4g}], blocks [{:.4g}, {:.4g}]".format(d, *r) for d, r in zip(D, ranges, strict=True)
            )
            values = zip([*log["free"], "lag"], z[: len(trial.unit)] * trial.unit, strict=False)
            none = trial.fit(0 * D, [z]).x
            print(f"  {label}: D {ends}; " + ", ".join(f"{k} = {v:.4g}" for k, v in values))
            print(f"    fit and held back {trial.errors(z, D)}, without delay {trial.errors(none, 0 * D)}", flush=True)

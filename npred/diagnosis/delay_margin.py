"""How wrong a constant D_hat may be: the linearised loop of a predictor that reads its own commands at D_hat. And how
long D may be without prediction.

With x' = A x + B u(t - D), u = K P and P the prediction of x by D_hat, the mismatch w = B (u(t - D) - u(t - D_hat)) is
all that the model does not know: P' = (A + B K) P + e^{A D_hat} w. So the characteristic equation is
    det(s I - A - B K - e^{A D_hat} B K (e^{-s D} - e^{-s D_hat})) = 0.
It is of retarded type: roots enter the right half-plane across the imaginary axis only, at bounded frequencies, and not
at 0. Let G be the response of u to w / B, G = K (s I - A - B K)^{-1} e^{A D_hat} B; the equation is det(I - T) = 0 with
T(s) = G(s) (e^{-s D} - e^{-s D_hat}). T has no unstable pole, so the loop is stable if det(I - T(iω)) does not turn
around 0 (Nyquist). No root crosses at a frequency where |T| < 1. On the line s = c + iω the turns count the roots to
the right of c, less the eigenvalues of A + B K there.

Several inputs: D_j = r_j D, and u_j = K_j P(D_hat_j). Along the prediction w grows by the flow Phi of A, in which the
loops of the inputs that have arrived are closed, and with L the longest D_hat_j
    G_j = K_j e^{s D_hat_j} [e^{-s L} (s I - A - B K)^{-1} Phi(L) + ∫ Phi(σ) e^{-s σ} dσ over D_hat_j < σ < L] B.

Without prediction D_hat = 0, and the same equation is det(s I - A - B K e^{-s D}) = 0.
"""

from dataclasses import replace
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.base.matrices import exponential
from npred.diagnosis import loops
from npred.diagnosis.case import Case, Verdict
from npred.plants.base import Plant, require

SEARCHED = 10.0  # times D plus the loop's slowest time constant: D_hat is looked at up to there
FIRST, LEAST, LONGER = 1e-2, 1e-3, 1.5  # the first and the shortest step of D_hat, in D; how much a next one may grow
SHARE = 0.5  # share of the distance from I - T to a singular matrix: a step of D_hat changes T by less
TOLERANCE = 1e-9  # error of the margin relative to D
GROWTH = 3 / np.pi  # a step to the left multiplies T by e to that, at most: far left it is too large to follow
FIRST_C, NEAR = 0.1 / np.pi, 1e-6  # shares of the slowest rate: the first step in c, without an eigenvalue; the last
QUIET = 0.5  # frequencies end where |T| stays below
FLAT = 0.01  # times the slowest rate of the loop: below it G does not depend on the frequency
HIGHEST = 1e6  # times the fastest rate of the loop: the highest frequency that is looked for
PHASE = 0.2  # rad, by which the delays turn T between two frequencies
AROUND = np.sinh(np.linspace(-6.0, 6.0, 41))  # times the damping of a pole: frequencies around it
TURN, HALVINGS = 0.5, 40  # rad between two points of the Nyquist curve; how often frequencies are halved for that
INSIDE, LONGEST = 0.9, 2.0  # share of the margin at which loops are simulated; times D, where it has no end
LOWEST = 1e-6  # times the slowest rate of the loop: the lowest frequency at which a loop without prediction may cross
POINTS = 16  # points of Gauss-Legendre, and one more per radian of an integrand


@overload
def delay_margin(plant: Plant, D: float) -> tuple[float, float]: ...
@overload
def delay_margin(plant: Plant) -> float: ...


def delay_margin(plant: Plant, D: float | None = None) -> tuple[float, float] | float:
    """The errors of a constant D_hat with which the loop is stable near rest; without D the longest delay that it bears
    without prediction.

    The controller predicts by a constant D_hat from its own commands (`actuator="history"`, `adaptation=None`). The
    loop, linearised at the equilibrium, is stable for every constant D_hat in (D + low, D + high), and at the ends a
    root is on the imaginary axis: the first crossing on each side. Without prediction, U = kappa(X), the linearised
    loop is stable for every delay below the longest. Time is continuous here, and no command is clipped.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    D : float, in the plant's unit of time, optional
        The delay, where inputs have several the longest. None for the loop without prediction.

    Returns
    -------
    tuple[float, float] or float
        (low, high), low <= 0 <= high, in the plant's unit of time. low = -D if the loop is stable down to D_hat =
        0. high = inf if it is stable up to ten times the sum of D and the loop's slowest time constant. Without D the
        longest delay, of several the longest one's; inf if the loop is stable with every delay, where inputs have
        several with all up to ten of those time constants.

    Raises
    ------
    ConfigError
        For a plant that declares its delay, has no equilibrium, or has a kappa that does not stabilise without
        delay, and for a D that is no time above 0.
    """
    require(plant)
    if D is None:
        unpredicted = UnpredictedLoop(plant)
        return unpredicted.edge(unpredicted.end)
    D = array_checks.number("D", D)
    if not 0 < D < np.inf:
        raise ConfigError(f"D: expected a time above 0, got {plant.time_text(D)}; give the plant's delay")
    loop = MismatchedLoop(plant, D)
    return loop.edge(0.0) - D, loop.edge(SEARCHED * (D + loop.slowest)) - D


def applies(case: Case) -> bool:
    """True if the plant rests, is sound and stable without delay, and its delay is a constant."""
    return case.sound and case.plant.rests and not case.plant.declares_delay and case.verdict("stability") == "yes"


def tolerated(case: Case) -> Verdict:
    """How wrong a constant estimate of the case's delay may be, near rest and for loops from the box, and how long the
    delay without prediction.
    """
    (low, high), longest = delay_margin(case.plant, case.D), delay_margin(case.plant)
    shown, D, bare = case.plant.time_text, case.D, min(INSIDE * longest, LONGEST * case.D)
    first, last = shown(D + low, ".4g"), None if np.isinf(high) else shown(D + high, ".4g")
    ends = f"of {first} or more" if last is None else f"between {first} and {last}"
    text = f"near rest the loop is stable for a constant estimate D_hat {ends}"
    unpredicted = "without prediction for " + ("every D" if longest == np.inf else f"D below {shown(longest, '.4g')}")
    figures: dict[str, Any] = {"D": D, "low": D + low, "high": None if np.isinf(high) else D + high}
    figures["longest_without_prediction"] = None if np.isinf(longest) else longest
    if not loops.applies(case):
        verdict = "yes" if low < high else "warn"
        return verdict, f"{text}, {unpredicted}; no loop from the box was simulated", figures
    inside = 0.0 if low == -D else D + INSIDE * low, D + INSIDE * high if high < np.inf else LONGEST * D
    each = [loops.ensemble(case, float(D_hat)) for D_hat in inside]
    experiment = case.experiment and replace(case.experiment, D=bare)
    late = loops.ensemble(replace(case, delay=bare, experiment=experiment, ensembles={}), 0.0)
    figures |= {"loops": [one.figures for one in each], "without_prediction": {"D": bare} | late.figures}
    if late.fails.any():
        unpredicted += f", near rest: loops from the box with D = {shown(bare, '.4g')}: {late.text()}"
    if not any(one.fails.any() for one in each):
        tried = " and ".join(shown(one.D_hat, ".4g") for one in each)
        return "yes", f"{text}; loops from the box are stable too, with D_hat = {tried}; {unpredicted}", figures
    failing = (f"with D_hat = {shown(one.D_hat, '.4g')} {one.text()}" for one in each if one.fails.any())
    return "warn", f"{text}; loops from the box are not: {'; '.join(failing)}; {unpredicted}", figures


class MismatchedLoop:
    """The linearised loop of a plant with delay D whose controller predicts by D_hat."""

    def __init__(self, plant: Plant, D: float):
        if plant.declares_delay:
            raise ConfigError(f"plant {plant.name}: expected a constant delay, it declares delay(x, t, p, M); drop it")
        rest = plant.equilibrium
        (self.closed, self.B), self.K = plant.linearised(), plant.kappa_jacobian(rest)
        self.D, self.r, self.unit = D, plant.ratios, D
        self.poles: NDArray[np.complex128] = np.full(1, np.inf + 0j)
        if np.isfinite(self.closed).all():
            self.poles = np.linalg.eigvals(self.closed).astype(complex)
        if not self.poles.real.max() < 0:
            got = f"got the eigenvalue {self.poles[np.argmax(self.poles.real)]:.3g} at rest"
            raise ConfigError(f"{plant.location('kappa')} expected to stabilise without delay, {got}; change its gains")

    @property
    def slowest(self) -> float:
        """The slowest time constant of the loop without delay, in seconds."""
        return float(1 / -self.poles.real.max())

    def edge(self, end: float) -> float:
        """The D_hat of the first crossing on the way from D to `end`; 0 or infinity where there is none; D itself where
        |T| is not small at any frequency: less than a millionth of the fastest time constant is borne.
        """
        a, step = self.D, FIRST * self.unit
        with np.errstate(over="ignore", invalid="ignore"):  # e^{A D} of an unstable plant
            if not np.linalg.norm(self.G(np.full(1, HIGHEST * np.abs(self.poles).max()), a)) < QUIET / 2:
                return a
        while a != end:
            b = a + np.clip(end - a, -step, step)
            omega = self.frequencies(a, b)
            T, next_T = self.T(omega, a), self.T(omega, b)
            near = np.linalg.svd(np.eye(len(self.r)) - T, compute_uv=False)[:, -1]
            if step > LEAST * self.unit and (np.linalg.norm(next_T - T, axis=(1, 2)) > SHARE * near).any():
                step /= 2
            elif self.stable(b):
                a, step = b, LONGER * step
            else:  # stability ends between a and b
                while abs(b - a) > TOLERANCE * self.unit:
                    middle = (a + b) / 2
                    a, b = (middle, b) if self.stable(middle) else (a, middle)
                return float((a + b) / 2)
        return 0.0 if end < self.D else np.inf

    def stable(self, D_hat: float) -> bool:
        """True if no root is in the right half-plane."""
        return self.roots(D_hat) == 0

    def rightmost(self, D_hat: float) -> float:
        """The largest real part of the roots, in 1/s: how fast small states decay or grow."""
        if D_hat == self.D:
            return -1 / self.slowest
        right = left = 0.0
        step = FIRST_C / self.slowest
        while self.roots(D_hat, right) > 0:
            left, right, step = right, right + step, 2 * step
        widest = GROWTH / float(self.r.max() * max(self.D, D_hat))
        while right <= 0 and self.roots(D_hat, left) == 0:
            step = min(step, widest)
            left, right, step = left - step, left, 2 * step
        while right - left > NEAR / self.slowest:
            middle = (left + right) / 2
            left, right = (middle, right) if self.roots(D_hat, middle) else (left, middle)
        return (left + right) / 2

    def roots(self, D_hat: float, c: float = 0.0) -> int:
        """The number of roots with a real part above c, by the turns of det(I - T(c + iω)), 0 < ω, around 0."""
        omega, eye = self.frequencies(D_hat, c=c), np.eye(len(self.r))
        curve = np.linalg.det(eye - self.T(omega, D_hat, c))
        for _ in range(HALVINGS):
            wide = np.abs(np.angle(curve[1:] / curve[:-1])) > TURN
            if not wide.any():
                break
            between = (omega[1:] + omega[:-1])[wide] / 2
            places = np.flatnonzero(wide) + 1
            curve = np.insert(curve, places, np.linalg.det(eye - self.T(between, D_hat, c)))
            omega = np.insert(omega, places, between)
        turns = np.angle(curve[1:] / curve[:-1]).sum() / np.pi  # a turn is 2 pi, half of it for ω > 0
        return int((self.poles.real > c).sum()) - round(turns)

    def frequencies(self, *D_hats: float, c: float = 0.0) -> np.ndarray:
        """Frequencies in rad/s from 0 to where |T| stays small: equally far, and denser around the poles."""
        around = (np.abs(self.poles.imag) + np.outer(AROUND, self.poles.real - c)).ravel()
        around, far = around[around > 0], np.geomspace(FLAT / self.slowest, HIGHEST * np.abs(self.poles).max(), 300)
        tried = np.unique(np.concatenate([far, around]))
        most = 2 * np.exp(-c * np.outer(self.r, (self.D, *D_hats))).max()  # |e^{-s D} - e^{-s D_hat}|
        gains = [np.linalg.norm(self.G(tried, D_hat, c), axis=(1, 2)) for D_hat in D_hats]
        loud = np.flatnonzero(np.max(gains, axis=0) >= QUIET / most)
        top = float(tried[min(loud.max(initial=-1) + 1, len(tried) - 1)])
        even = np.arange(0.0, top + 1.0 / max(self.D, *D_hats), PHASE / max(self.D, *D_hats))
        return np.unique(np.concatenate([even, around[around < top]]))

    def T(self, omega: np.ndarray, D_hat: float, c: float = 0.0) -> np.ndarray:
        """The return ratio T(c + iω), (frequencies, m, m)."""
        turns = -np.outer(c + 1j * omega, self.r)
        return self.G(omega, D_hat, c) * (np.exp(turns * self.D) - np.exp(turns * D_hat))[:, None, :]

    def G(self, omega: np.ndarray, D_hat: float, c: float = 0.0) -> np.ndarray:
        """The response of the commands to a mismatch at the inputs, (frequencies, m, m), at s = c + iω."""
        order, s = np.argsort(self.r), c + 1j * omega
        ends = D_hat * self.r[order]
        A, eye = self.closed - self.B @ self.K, np.eye(len(self.closed))
        flow, pieces = exponential(A * ends[0]), []
        for j, begin, end in zip(order[:-1], ends[:-1], ends[1:], strict=True):
            A = A + np.outer(self.B[:, j], self.K[j])
            # ∫ e^{A (σ - begin)} flow B e^{-s σ} dσ from begin to end, (frequencies, n, m)
            h, speed, piece = end - begin, np.linalg.norm(A, 2), np.empty((len(s), *self.B.shape), complex)
            across, fast = exponential(A * h), np.abs(s) > 2 * speed  # where A - s I is far from singular
            last, first = (np.exp(-s[fast] * moment)[:, None, None] for moment in (end, begin))
            right = (last * across - first * eye) @ flow @ self.B
            piece[fast] = np.linalg.solve(A - s[fast, None, None] * eye, right)
            x, weights = np.polynomial.legendre.leggauss(POINTS + int(3 * h * speed))
            q = h * (x + 1) / 2
            waves = np.exp(-np.outer(s[~fast], begin + q)) * weights * h / 2
            piece[~fast] = np.einsum("wq,qij->wij", waves, exponential(A * q[:, None, None]) @ flow @ self.B)
            pieces.append(piece)
            flow = across @ flow
        resolvent = s[:, None, None] * eye - self.closed
        x = np.exp(-s * D_hat)[:, None, None] * np.linalg.solve(resolvent, flow @ self.B + 0j)
        G = np.empty((len(omega), len(order), len(order)), complex)
        for j, end, piece in zip(order[::-1], ends[::-1], [0.0, *pieces[::-1]], strict=True):
            x = x + piece
            G[:, j] = np.exp(s * end)[:, None] * np.einsum("i,wij->wj", self.K[j], x)
        return G


class UnpredictedLoop(MismatchedLoop):
    """The linearised loop of a plant whose controller does not predict: D_hat is 0, and what moves is D."""

    def __init__(self, plant: Plant):
        """`end` is as long as D may have to be: beyond it, a loop with one delay would have lost its stability."""
        super().__init__(plant, 0.0)
        A, eye = self.closed - self.B @ self.K, np.eye(plant.n)
        open_poles = np.linalg.eigvals(A)
        widths = np.maximum(np.abs(open_poles.real), LOWEST * np.abs(open_poles))
        omega = np.append(
            np.geomspace(LOWEST / self.slowest, HIGHEST * np.abs(self.poles).max(), 400),
            np.abs(open_poles.imag) + np.outer(AROUND[AROUND != 0], widths),
        )
        omega = np.sort(omega[omega > 0])
        gains = self.K @ np.linalg.solve(1j * omega[:, None, None] * eye - A, self.B + 0j)
        loud = omega[np.abs(np.linalg.eigvals(gains)).max(axis=1) >= 1]
        top = loud.max(initial=0.0)  # no root crosses at a higher frequency, and at this one the last does
        several, crossed = len(np.unique(self.r)) > 1, 2 * np.pi / top if top else 0.0
        self.unit = 1 / max(top, 1 / self.slowest)
        self.end = max(crossed / self.r.min(), SEARCHED * self.slowest * several)

    def G(self, omega: np.ndarray, D_hat: float, c: float = 0.0) -> np.ndarray:
        return super().G(omega, 0.0, c)

    def T(self, omega: np.ndarray, D_hat: float, c: float = 0.0) -> np.ndarray:
        return -super().T(omega, D_hat, c)

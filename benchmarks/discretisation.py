"""What control steps, nodes and cell means cost: figures of docs/fidelity.md, docs/predictors.md, docs/real_loop.md, …

    python benchmarks/discretisation.py [mesh] [tracking] [order] [margin] [published] [delay] [default] [exact]

mesh: D_hat at the end of Fig. 1's loop against the mesh limit of an independent solver, for smaller and smaller dt.
tracking: where D_hat of a loop that follows sin t ends.
order: the error of P(1) of nodes whose inputs a loop gives, and of a smooth u, and its fitted order.
margin: the lowest 1 - D_X f of the exact loop, by SciPy, that npred takes for infeasible.
published: what two digits of docs/reproduce.md are of.
delay: what loops lose by fewer control steps in a delay.
default: what the default control steps lose, for delays of a tenth, a third and all of a usual one.
exact: delays of one to three control steps against an exact sampled predictor.
"""

import time
from functools import partial

import harness
import numpy as np
from plants import Led, declared
from scipy.integrate import solve_ivp
from scipy.linalg import expm, solve_discrete_are

import npred
from npred.loop import control_step, hold
from npred.plants import Plant

TIGHT = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-13}


def mesh() -> None:
    """Unclipped and with U >= 0, as in tests/loop/test_closed_loop.py, where the limits come from."""
    plant, law = npred.plant("activator_repressor"), npred.DelayAdaptation(1000.0, 1.0, (0.1, 4.0))
    print("Fig. 1: D = 1, D_hat(0) = 2, X0 = (0.03, 30), 100 s; D_hat(100) above its limit")
    for clip, limit in ((None, 1.19226), ([(0.0, np.inf)], 0.4975)):
        for dt in (0.01, 0.005, 0.0025, 0.00125):
            gaps = []
            for nx in (101, round(1 / dt) + 1):
                run = npred.simulate(
                    plant, npred.predictor(plant, "rk4", nx), D=1.0, D_hat=2.0, X0=[0.03, 30.0], t_end=100.0, dt=dt,
                    adaptation=law, input_bounds=clip, u0=[0.0], every=round(1 / dt),
                )  # fmt: skip
                gaps.append(f"{run.D_hat[-1] / limit - 1:.3%} on {nx} nodes")
            print(f"  {'U >= 0' if clip else 'unclipped':9s}  dt = {dt:<8g}  {'; '.join(gaps)}", flush=True)


def tracking() -> None:
    """D = 1, gamma = 0.2, 101 nodes."""
    plant, law = Plant("follower", Led), npred.DelayAdaptation(gamma=0.2, bounds=(0.1, 3.0))
    for X0 in (0.0, 0.5):
        for dt in (0.01, 0.005):
            run = npred.simulate(
                plant, npred.predictor(plant, "rk4", 101), D=1.0, D_hat=[0.8, 1.2], X0=[X0], t_end=400.0, dt=dt,
                adaptation=law, every=round(100 / dt),
            )  # fmt: skip
            ends = "; ".join(f"D_hat({t:g}) = {a:.4f}, {b:.4f}" for t, (a, b) in zip(run.t, run.D_hat.T, strict=True))
            print(f"X0 = {X0:g}, dt = {dt:g}: {ends}", flush=True)


def _held(plant: Plant, X: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
    """X (B, n) after the inputs u (B, N), each held for h: a step of RK4 for each, of error 1e-13 here."""
    for now in np.moveaxis(u[..., None], 1, 0):
        X = harness.rk4(partial(plant.f, u=now), X, h)
    return X


def order() -> None:
    """The paper's plant, D = D_hat = 1: a loop from (0.06, 12) with dt = 0.5 ms; and u = .05 cos 3x.

    Errors of the loop are root mean squares over five times, before 1 s, when the history has the jump of u at t = 0 in
    it, and after 2 s, when it is smooth. A smooth u comes as its means over cells, as in a loop, and as values.
    """
    plant, dt = npred.plant("activator_repressor"), 5e-4
    N, intervals = round(1 / dt), np.array([10, 20, 40, 80, 160])
    times = {"jump": [0.113, 0.271, 0.437, 0.619, 0.853], "no jump": [2.113, 2.271, 2.437, 2.619, 2.853]}
    start, fine = np.array([[0.06, 12.0]]), 20_000
    smooth = _held(plant, start, 0.05 * np.cos(3 * (np.arange(fine) + 0.5)[None] / fine), 1 / fine)[0]
    for name in ("heun", "rk4"):
        errors: dict[str, list[float]] = {what: [] for what in ("jump", "no jump", "means", "values")}
        for nx in intervals + 1:
            method = npred.predictor(plant, name, int(nx))
            run = npred.simulate(plant, method, D=1.0, D_hat=1.0, X0=start[0], t_end=3.0, dt=dt, u0=[0.0])
            U = np.concatenate([np.zeros(N), run.U[:, 0]])
            for what, at in times.items():
                k = np.round(np.array(at) / dt).astype(int)
                exact = _held(plant, run.X[k], np.stack([U[i : i + N] for i in k]), dt)
                errors[what].append(np.sqrt(np.square(run.P[k] - exact).sum(axis=-1).mean()))
            x = np.linspace(0, 1, nx)
            low, high = np.clip(x - x[1] / 2, 0, 1), np.clip(x + x[1] / 2, 0, 1)
            inputs = {"means": (np.sin(3 * high) - np.sin(3 * low)) / 3 / (high - low), "values": np.cos(3 * x)}
            for what, u in inputs.items():
                errors[what].append(np.linalg.norm(method(start[0], 0.05 * u[:, None], 1.0)[-1] - smooth))
        for what, found in errors.items():
            slope = -np.polyfit(np.log(intervals), np.log(found), 1)[0]
            print(f"{name:5s} {what:8s} " + "  ".join(f"{e:.1e}" for e in found) + f"  order {slope:.1f}", flush=True)


def _squares(x, t, p, M):
    return x.x**2 + x.y**2


def margin() -> None:
    """The unicycle with D = x² + y² from (a, a, a): the largest a that npred keeps, and the exact loop's margin."""
    late = type("Late", (npred.plant("unicycle").declaration,), {"delays": None, "delay": _squares})
    plant = Plant("late", late)
    for dt in (0.02, 0.01, 0.005, 0.0025):
        for nx in (51, 101, 401):
            low, high = 0.5, 1.0
            while high - low > 1e-4:
                a = (low + high) / 2
                run = npred.simulate(plant, npred.predictor(plant, "rk4", nx), X0=[a, a, a], t_end=6.0, dt=dt)
                low, high = (a, high) if run.infeasible == -1 else (low, a)
            print(f"dt = {dt:<7g} nx = {nx:<4d} a = {low:.4f}  lowest margin, exact: {lowest(low):.4f}", flush=True)


def published() -> None:
    """`npred reproduce`: what an exact predictor scores in unicycle_constant, and unicycle_time_varying by dt."""
    from npred_experiments import pomet
    from npred_experiments import unicycle_constant as constant
    from npred_experiments import unicycle_time_varying as varying

    plant, score = pomet.plant(), []
    loop = constant.meant_loop(npred.predictor(plant, "rk4", constant.NODES + 1), constant.draws())
    for X, U, D in zip(loop.X, loop.U, constant.draws()[1], strict=True):
        i = (loop.t + D) / constant.DT
        inside = i <= len(X) - 1
        k, share = np.divmod(i[inside], 1)
        k, before = k.astype(int), np.maximum(np.flatnonzero(inside) - 1, 0)  # of t = 0 the command before it was 0
        acting = U[before] * (np.flatnonzero(inside) > 0)[:, None]
        exact = harness.rk4(partial(plant.f, u=acting), X[k], (share * constant.DT)[:, None])
        line = X[k] + share[:, None] * (X[np.minimum(k + 1, len(X) - 1)] - X[k])
        score.append(np.linalg.norm(exact - line, axis=-1).mean())
    print(f"unicycle_constant: RK4 {constant.meant():.7f}, an exact predictor {np.mean(score):.7f}", flush=True)
    X0, slopes = varying.draws()
    for dt in (0.01, 0.005, 0.001, 0.0005):  # the mean is over samples of 0.01 s with each
        norms = []
        for start, b in zip(np.moveaxis(X0, 1, 0), slopes.tolist(), strict=True):
            rk4 = varying.rk4(b)
            run = npred.simulate(rk4.plant, rk4, X0=start.T, t_end=9.99, dt=dt, every=round(0.01 / dt))
            norms.append(np.linalg.norm(run.X, axis=-1).mean())
        print(f"unicycle_time_varying: dt = {dt:g}: {np.mean(norms):.6f}", flush=True)


def lowest(a: float) -> float:
    """The lowest 1 - D_X f along the exact loop from (a, a, a): P' = f / margin, s' = 1 / margin, s(0) = D(P(0))."""

    def kappa(X, t):
        p, q = X[0] * np.cos(X[2]) + X[1] * np.sin(X[2]), X[0] * np.sin(X[2]) - X[1] * np.cos(X[2])
        omega = -5 * p**2 * np.cos(3 * t) - p * q * (1 + 25 * np.cos(3 * t) ** 2) - X[2]
        return omega, -p + 5 * q * (np.sin(3 * t) - np.cos(3 * t)) + q * omega

    def rate(z):
        omega, v = kappa(z[:3], z[3])
        f = np.array([v * np.cos(z[2]), v * np.sin(z[2]), omega])
        return f, 1 - 2 * z[0] * f[0] - 2 * z[1] * f[1]

    def slope(_, z):
        f, margin = rate(z)
        return np.array([*f, 1.0]) / margin

    run = solve_ivp(slope, (0, 6), [a, a, a, 2 * a * a], dense_output=True, **TIGHT)
    return min(rate(z)[1] for z in run.sol(np.linspace(0, 6, 20001)).T)


CASES = {  # a delay, and a start
    "activator_repressor": (1.0, [0.03, 30.0]), "scalar": (1.0, [1.0]), "van_der_pol": (0.5, [1.0, 0.0]),
    "chemostat": (1.5, [2.0, 2.0]), "cart_pole": (0.2, [0.1, 0.0, 0.1, 0.0]),
}  # fmt: skip


def _lost(plant, D: float, dt: float, parts: int, **loop) -> float:
    """sup |X - X_fine| of each state, over the largest distance of X_fine from rest; D known, X_fine by dt / parts."""
    rk4 = npred.predictor(plant, "rk4")
    run, fine = (npred.simulate(plant, rk4, D=D, D_hat=D, dt=dt / k, every=k, **loop) for k in (1, parts))
    count = min(len(run.X), len(fine.X))
    size = np.abs(fine.X - plant.equilibrium).max(axis=0)
    return float((np.abs(run.X[:count] - fine.X[:count]) / size).max())


def delay() -> None:
    """What a loop loses by fewer and fewer control steps in a known delay, and what npred says of small states."""
    for name, (D, X0) in CASES.items():
        plant, shown = npred.plant(name), []
        loop = {"X0": X0, "t_end": 20.0 * D, "actuator": "history"}
        for steps in (300, 60, 20, 10, 5, 2, 1):
            lost = _lost(plant, D, D / steps, 3000 // steps, **loop)
            shown.append(f"{steps}: {lost:.1%} ({hold.loss(plant, D / steps):.1%})")
        print(f"{name}, D / dt = {', '.join(shown)}", flush=True)


def default() -> None:
    """Default control steps beside D / 300 and D / 20: what the loop loses, the error of D_hat at its end, the time."""
    print("plant                    D      dt  D / dt   loss  |D_hat / D - 1|      ms")
    for name, (longest, X0) in CASES.items():
        plant = npred.plant(name)
        rk4 = npred.predictor(plant, "rk4")
        for D in (0.1 * longest, 0.3 * longest, longest):
            for dt in (D / 300, control_step.usual(D, plant), D / 20):
                loop = {"X0": X0, "t_end": 20 * longest, "dt": dt, "actuator": "history"}
                lost, law = _lost(plant, D, parts=8, **loop), npred.DelayObserver(bounds=(D / 6, 10 / 3 * D))
                seconds = []
                for _ in range(3):
                    began = time.process_time()
                    run = npred.simulate(plant, rk4, D=D, D_hat=2 * D, adaptation=law, **loop)
                    seconds.append(time.process_time() - began)
                error, ms = abs(run.D_hat[-1] / D - 1), 1e3 * min(seconds)
                print(f"{name:20} {D:5g} {dt:8.3g} {D / dt:5.0f} {lost:8.2%} {error:10.1e} {ms:14.0f}", flush=True)


def exact() -> None:
    """Delays of 1 to 3 control steps, a linear plant, a law designed for held commands: npred against matrices.

    The referee is x(k + 1) = A_d x(k) + B_d u(k - d), u = -K x(k + d), by SciPy's expm and its discrete LQR.
    """

    cart = declared(  # RK4 is exact for commands that are held
        "Cart", "x v", "u", lambda x, u, t, p, M: [x.v, u.u], [(-1.0, 1.0), (-1.0, 1.0)],
        parameters={"k1": 0.0, "k2": 0.0}, kappa=lambda x, t, p, M: [-p.k1 * x.x - p.k2 * x.v],
    )  # fmt: skip
    dt = 1.0
    step = expm(dt * np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]))
    A, B = step[:2, :2], step[:2, 2:]
    S = solve_discrete_are(A, B, np.eye(2), np.eye(1))
    K = np.linalg.solve(np.eye(1) + B.T @ S @ B, B.T @ S @ A)[0]
    plant = Plant("cart", cart, {"k1": K[0], "k2": K[1]})
    for d in (1, 2, 3):
        run = npred.simulate(
            plant, npred.predictor(plant, "rk4", 61), D=d * dt, D_hat=d * dt, X0=[0.5, 0.0], t_end=30.0, dt=dt,
            actuator="history", u0=[0.0],
        )  # fmt: skip
        x, commands = np.array([0.5, 0.0]), [0.0] * d
        worst = 0.0
        for X in run.X:
            worst = max(worst, float(np.abs(X - x).max()))
            ahead = x
            for u in commands[-d:]:
                ahead = A @ ahead + B[:, 0] * u
            commands.append(float(-K @ ahead))
            x = A @ x + B[:, 0] * commands[-d - 1]
        print(f"D = {d} dt: sup |X - exact| = {worst:.1e}, |X| at the end {np.abs(run.X[-1]).max():.1e}", flush=True)


if __name__ == "__main__":
    for part in harness.chosen(__doc__, mesh, tracking, order, margin, published, delay, default, exact):
        part()

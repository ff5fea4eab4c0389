"""`npred plants check` compares the predictor with a PI and a Smith predictor that are tuned on the same plant."""

import numpy as np
import pytest
from scipy.optimize import minimize

import npred
from npred.diagnosis import Answer, Case, pi
from npred.plants import Plant


class Lag:
    """T x' = -x + K u, with a set-point."""

    states, inputs, parameters = ("x",), ("u",), {"aim": 1.0}
    box, input_bounds = {"x": (0.0, 2.0)}, ((0.0, 4.0),)
    f = lambda x, u, t, p, M: [u.u - x.x]
    setpoint = lambda x, t, p, M: [x.x - p.aim]


def lag(R):
    return npred.plant(Lag, kappa={"law": "lqr", "R": [[R]]})


def case_of(plant, D):
    return Case(plant, D, 101, 256)


def referee(k, T_i, D, dt, t_end, push, smith=False, known=None):
    """∫ |e| dt by plain loops over the exact step of the lag; commands as in the docstring of npred.diagnosis.pi."""
    a, known = np.exp(-dt), round((known or D) / dt)
    x = model = 0.0
    late, share = int(D / dt + 1e-9), max(D / dt - int(D / dt + 1e-9), 0.0)
    integral, total, sent, models = 0.0, 0.0, [0.0] * (late + 1), [0.0] * known
    for _ in range(round(t_end / dt)):
        e = -x
        total += abs(e) * dt
        if smith:
            models.append(model)
            e -= model - models[-1 - known]
        free = k * (e + integral / T_i)
        U = min(max(free, -1.0), 3.0)
        integral += e * dt if free == U or k * e * (free - U) < 0 else 0.0
        sent.append(U)
        b = np.exp(-(1 - share) * dt)  # what of x is left after the newer command, which acts last
        x = a * x + (1 - b) * sent[-1 - late] + (b - a) * sent[-2 - late] + (1 - a) * push
        model = a * model + (1 - a) * U
    return total


@pytest.mark.parametrize("smith", [False, True])
@pytest.mark.parametrize("known", [0.15, 1.0])
def test_the_rivals_are_those_of_the_equations(smith, known):
    """Also where a delay is no whole number of control steps."""
    task = pi.task_of(case_of(lag(1.0), known))
    D = pi.OFF * task.D
    found = pi.iae(task, np.full(3, 0.8), np.full(3, 1.5), smith, D)
    exact = [referee(0.8, 1.5, each, task.dt, task.t_end, task.push, smith, task.D) for each in D]
    np.testing.assert_allclose(found, exact, rtol=1e-3)


@pytest.mark.parametrize("smith", [False, True])
def test_no_search_finds_clearly_better_gains(smith):
    """Nelder and Mead's, from the best of the grid: the rivals are not weak."""
    task = pi.task_of(case_of(lag(1.0), 1.0))
    best = pi.tuned(task, smith)

    def cost(z):
        gains = [np.full(3, value) for value in np.exp(z)]
        return float(pi.iae(task, *gains, smith, pi.OFF * task.D).max())

    search = minimize(cost, np.log([best.k, best.T_i]), method="Nelder-Mead", options={"maxfev": 60})
    assert best.iae == pytest.approx(cost(np.log([best.k, best.T_i]))) and best.iae < 1.05 * search.fun


def test_a_slow_law_is_told_that_a_pi_does_better_and_a_fast_one_is_not():
    slow, fast = (pi.compared(case_of(lag(R), 1.0)) for R in (30.0, 0.3))
    assert slow[0] == "warn" and slow[1].endswith(
        "the PI does as well or better: keep it, or change the gains of kappa"
    )
    assert fast[0] == "yes" and "PI does" not in fast[1]
    rival = fast[2]["PI"]["iae"]
    assert slow[2]["predictor"] > rival > fast[2]["predictor"] and slow[2]["PI"]["iae"] == pytest.approx(
        rival, rel=0.05
    )


def test_no_loop_that_is_not_kept_is_a_good_answer(monkeypatch):
    monkeypatch.setattr(pi, "predicted", lambda *_: (np.inf, 1.0))
    monkeypatch.setattr(pi, "tuned", lambda *_: pi.RivalGains(1.0, 1.0, np.inf))
    verdict, text, figures = pi.compared(case_of(lag(1.0), 1.0))
    assert verdict == "warn" and "the predictor does not keep the loop" in text
    assert figures["predictor"] is None and figures["PI"] == {"k": 1.0, "T_i": 1.0, "iae": None}


def test_a_smith_predictor_keeps_no_unstable_plant_and_a_pi_hardly():
    verdict, text, figures = pi.compared(case_of(npred.plant("scalar"), 1.0))
    assert verdict == "yes" and "no end (not kept) with a tuned Smith predictor" in text
    assert figures["Smith"]["iae"] is None
    assert figures["PI"]["iae"] is None or figures["PI"]["iae"] > 3 * figures["predictor"]


def test_it_is_asked_where_one_input_leads_one_output():
    class Two:
        states, inputs, box = ("x", "y"), ("u",), {"x": (-1.0, 1.0), "y": (-1.0, 1.0)}
        f = lambda x, u, t, p, M: [x.y, u.u - x.x]
        kappa = lambda x, t, p, M: [-x.y]

    for parts, asked in (({}, False), ({"output": lambda x, t, p, M: [x.x]}, True)):
        case = case_of(Plant("two", type("Two", (Two,), parts)), 1.0)
        assert not pi.applies(case)
        case.answers["disturbance"] = Answer("disturbance", "yes", "")
        assert pi.applies(case) is asked
    short = pi.compared(case_of(lag(1.0), 0.01))
    assert short[0] == "yes" and short[1].startswith("not compared: the delay is too short")

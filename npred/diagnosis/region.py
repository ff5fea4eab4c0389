"""Where in the box the loop of a law converges without delay, and which laws a plant without one may take."""

import inspect
from dataclasses import replace

import numpy as np

from npred import plants
from npred.base.errors import ConfigError
from npred.base.registry import LAWS
from npred.diagnosis import equilibrium
from npred.diagnosis.case import Answer, Case
from npred.plants.base import Plant

EIGHTHS, HALF = 8, 4  # sub-boxes that are looked at, and the one that a law should converge from


def offers(plant: Plant, case: Case) -> list[Answer]:
    """An answer per law that is designed from f alone: where its loop converges, or why it does not serve."""
    return [offer(name, plant, case) for name in LAWS.names() if not _takes_more(name)]


def instead(plant: Plant, case: Case) -> Answer:
    """The first other law that is designed from f alone and converges from half the box, or that no such law does."""
    tried, faults = [], {"warn": "does not converge from half the box", "no": "does not fit the plant"}
    for name in LAWS.names():
        if name != plant.law_table["law"] and not _takes_more(name):
            answer = offer(name, plant, case)
            if answer.verdict == "yes":
                return Answer("other law", "yes", f"{name}: {answer.text}")
            tried.append(f"{name} {faults[answer.verdict]}")
    return Answer("other law", "warn", f"none: {', '.join(tried)}")


def offer(name: str, plant: Plant, case: Case) -> Answer:
    """Where the loop of that law converges, or why the plant does not take it."""
    try:
        return converging(name, replace(case, plant=plants.controlled(plant, name), answers={}))
    except ConfigError as fault:
        return Answer(name, "no", str(fault))


def _takes_more(name: str) -> bool:
    """True if a law takes more than the plant, as poles."""
    parameters = inspect.signature(LAWS.load("kappa", name)).parameters.values()
    return sum(parameter.default is parameter.empty for parameter in parameters) > 1


def converging(name: str, case: Case) -> Answer:
    """The share of starts in the box from which loops without delay converge, and the largest sub-box of which all do.

    A sub-box is the box, shrunk by eighths about the point of it that is nearest to the target.
    """
    X0 = case.X[: equilibrium.LOOPS]
    centre = np.clip(case.plant.target(0.0), *case.ends.T)
    _, seconds, horizon = equilibrium.times(case)
    looked = f"in {case.plant.time_text(seconds, '.3g')}"
    looked += "" if seconds >= horizon else f", as long as was looked, of the {horizon:.3g} that its slowest rate takes"
    shares: dict[int, float] = {}
    for eighth in range(EIGHTHS, 0, -1):
        home = equilibrium.approach(case, centre + eighth / EIGHTHS * (X0 - centre))[1] <= equilibrium.HOME
        shares[eighth] = home.mean()
        if home.all():
            break
    parts = ["from all of them" if shares[EIGHTHS] == 1 else f"from {shares[EIGHTHS]:.0%} of them"]
    if shares.get(HALF, 1.0) < 1:
        parts.append(f"from {shares[HALF]:.0%} of half of it")
    if eighth < EIGHTHS:
        all_from = f"and all from {eighth}/{EIGHTHS} of it about {case.state(centre)}"
        parts.append(all_from if shares[eighth] == 1 else "not from all of any sub-box")
    verdict = "yes" if shares[eighth] == 1 and eighth >= HALF else "warn"
    return Answer(name, verdict, f"{len(X0)} starts in the box, without delay: converges {', '.join(parts)}, {looked}")

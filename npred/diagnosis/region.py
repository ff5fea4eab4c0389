"""Where in the box the loop of a law converges without delay, and which laws a plant without one may take."""

import inspect

import numpy as np

from npred import plants
from npred.diagnosis import equilibrium
from npred.diagnosis.case import Answer, Case
from npred.errors import ConfigError
from npred.plants.base import Plant
from npred.registry import LAWS

EIGHTHS = 8  # sub-boxes that are looked at


def offers(plant: Plant, case: Case) -> list[Answer]:
    """An answer per law that is designed from f alone: where its loop converges, or why it does not serve."""
    answers = []
    for name in LAWS.names():
        if _takes_more(name):
            continue
        try:
            controlled = plants.controlled(plant, name)
            answers.append(converging(name, Case(controlled, case.delay, case.nodes, case.samples, case.pipeline)))
        except ConfigError as fault:
            answers.append(Answer(name, "no", str(fault)))
    return answers


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
    share = 0.0
    for eighth in range(EIGHTHS, 0, -1):
        home = equilibrium.approach(case, centre + eighth / EIGHTHS * (X0 - centre))[1] <= equilibrium.HOME
        share = home.mean() if eighth == EIGHTHS else share
        if home.all():
            smaller = f"from {share:.0%} of them, and all from {eighth}/{EIGHTHS} of it about {case.state(centre)}"
            part = "from all of them" if eighth == EIGHTHS else smaller
            return Answer(name, "yes", f"{len(X0)} starts in the box, without delay: converges {part}, {looked}")
    text = (
        f"{len(X0)} starts in the box, without delay: converges from {share:.0%} of them, not from all of any sub-box"
    )
    return Answer(name, "warn", f"{text}, {looked}")

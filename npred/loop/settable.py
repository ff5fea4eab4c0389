"""Which parameters a controller can be set to while it runs, and why it cannot be set to the others."""

import numpy as np

from npred.formulas import programs
from npred.formulas.trace import Trace
from npred.guard.guarded import bare
from npred.laws import Law
from npred.plants.base import Plant
from npred.prediction.methods import Predictor


def fixed(plant: Plant, predictor: Predictor) -> dict[str, str]:
    """Why a parameter cannot be set, by its name; those that are not here can be.

    A network was trained for what the prediction reads, and the gains of a law of npred.laws are those of one f.
    """
    if not plant.traced:
        return dict.fromkeys(plant.parameters, "the functions of a plant with traced = False are called as they are")
    declared = {"delay": plant.declares_delay, "output": plant.declares_output, "safe": plant.declares_safe}
    others = [name for name, has in (declared | {"reference": plant.tracks}).items() if has]
    in_f, in_any = _read(plant, "f"), _read(plant, "f", "kappa", "V", *others)
    predicted = ["f", *(["delay"] if plant.declares_delay else []), *([] if plant.one_delay else ["kappa"])]
    trained = _read(plant, *predicted) if hasattr(bare(predictor), "operator") else set()
    designed = in_f if isinstance(plant.law, Law) else set()
    reasons = {
        name: "the network was trained with it" if name in trained else "the law was designed with it"
        for name in (*trained, *designed)
    }
    return {name: "nothing reads it" for name in plant.parameters if name not in in_any} | reasons


def _read(plant: Plant, *functions: str) -> set[str]:
    """The parameters that functions read, by themselves or by the rest that follows from them."""
    trace = Trace(plant)
    x, u, t = trace.symbols()
    outputs: list[object] = []
    for name in functions:
        arguments = {"f": (x, u, t), "reference": (t,)}.get(name, (x, t))
        outputs += [*np.ravel(np.array(getattr(trace, name)(*arguments), dtype=object))]
    symbols = zip(plant.p_names, trace.parameters, strict=True)
    names = {name for name, symbol in symbols if programs.depends(outputs, [symbol])}
    if not names <= plant.parameters.keys():
        names |= _read(plant, "f", "setpoint")
    return names & plant.parameters.keys()

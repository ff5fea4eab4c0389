"""What the author of a plant may have meant, where a declared function failed."""

import re

from npred.symbolic import source_lines
from npred.symbolic.declared import Declared
from npred.symbolic.tape import FUNCTIONS

SIGNATURES = {"f": "f(x, u, t, p, M)", "reference": "reference(t, p, M)"}
SIGNATURES |= {name: f"{name}(x, t, p, M)" for name in ("kappa", "V")}
ON_ROWS = {"f": "f(X, u, t, p)", "reference": "reference(t, p)", "df": "df(X, u, t, p, v)"}
ON_ROWS |= {"kappa": "kappa(X, t, p)", "V": "V(X, t, p)", "dkappa": "dkappa(X, t, p, v)"}
HINTS = {
    "for &": "write M.where(a, M.where(b, yes, no), no) for a and b",
    "for |": "write M.where(a, yes, M.where(b, yes, no)) for a or b",
    "tuple indices must be": "states, inputs and parameters have names: write x.name, u.name, p.name",
    "'Symbol' object has no attribute": "look at the order of the arguments: write def {signature}",
}
RETURNS = {
    "f": "a derivative each",
    "kappa": "an input each",
    "reference": "a value each",
    "V": "one number, not a list",
}


def cure(plant: Declared, function: str, error: Exception) -> str:
    """What to do about a failure of a declared function."""
    signature = (SIGNATURES if plant.traced else ON_ROWS)[function]
    if not source_lines.where(error, getattr(plant.declaration, function)):  # it was not even entered
        return f"write def {signature}"
    known = getattr(getattr(error, "obj", None), "_fields", None)
    if isinstance(error, AttributeError) and known is not None:
        return f"expected one of {', '.join(known) or 'none: none is declared'}"
    if isinstance(error, NameError):
        return _meant(str(error.name), plant, function, signature)
    for words, hint in HINTS.items():
        if words in str(error):
            return hint.format(signature=signature)
    ufunc = re.search(r"no callable (\w+) method", str(error))
    return f"write M.{ufunc[1]}" if ufunc else f"fix {function}"


def _meant(name: str, plant: Declared, function: str, signature: str) -> str:
    """What to write for a name that the function does not know."""
    homes = {"p": plant.parameters} | ({"x": plant.states, "M": (*FUNCTIONS, "where", "pi")} if plant.traced else {})
    if function == "f" and plant.traced:
        homes["u"] = plant.inputs
    for home, names in homes.items():
        if name in names:
            return f"write {home}.{name}"
    known = signature.partition("(")[2].rstrip(")")
    if name in ("u", *plant.inputs) and function != "f":
        return f"only f knows the inputs, and kappa gives them: write {function} in {known}"
    return f"expected one of {known}, or what the file defines"

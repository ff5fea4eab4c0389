"""Laws kappa that are designed from f alone, without delay; npred applies them to P.

Each is a file and a line of npred.base.registry.LAWS: a function of a plant that gives a kappa(x, t, p, M).
"""

from npred.laws.law import Law
from npred.laws.linearisation import feedback_linearisation, pole_placement
from npred.laws.regulator import lqr
from npred.laws.universal import sontag

__all__ = ["Law", "feedback_linearisation", "lqr", "pole_placement", "sontag"]

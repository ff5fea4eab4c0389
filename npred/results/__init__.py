"""The results of the stages as frozen models of result.json: one file per stage, and the contenders compared."""

from npred.results.base import Number, Result
from npred.results.bench import Benched
from npred.results.certify import Certified
from npred.results.contender import NO_ADAPTATION, NUMERICAL, Contender, ranked
from npred.results.evaluate import Evaluated
from npred.results.generate import Generated
from npred.results.report import Reported
from npred.results.reproduce import Reproduced, ReproducedRow
from npred.results.train import Trained

__all__ = [
    "NO_ADAPTATION",
    "NUMERICAL",
    "Benched",
    "Certified",
    "Contender",
    "Evaluated",
    "Generated",
    "Number",
    "Reported",
    "Reproduced",
    "ReproducedRow",
    "Result",
    "Trained",
    "ranked",
]

"""The results of the stages as frozen models of result.json: each stage's findings, the predictors compared."""

from npred.lab.config.results.base import (
    NO_ADAPTATION,
    NUMERICAL,
    BeforeAfter,
    Generated,
    IdentifiedResult,
    JudgedLoops,
    PredictorId,
    Reported,
    Result,
    Trained,
    Tuned,
    TunedNumber,
    ranked,
)
from npred.lab.config.results.bench import Benched
from npred.lab.config.results.evaluate import Certified, Evaluated

__all__ = [
    "NO_ADAPTATION", "NUMERICAL", "Benched", "Certified", "PredictorId", "Evaluated", "Generated", "IdentifiedResult",
    "BeforeAfter", "JudgedLoops", "Reported", "Result", "Trained", "Tuned", "TunedNumber", "ranked",
]  # fmt: skip

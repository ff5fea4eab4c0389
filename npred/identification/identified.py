"""The answer of a log about a plant, and its limits, in numbers and in sentences."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from npred.base.notebook import InNotebook
from npred.identification.alternatives import Validation
from npred.identification.objections import CLOSED, Evidence
from npred.identification.windows import Windows
from npred.plants import Plant

RUN_AWAY = 1e20  # an error that is no number for people
ODD = 2.0  # times what was allowed: a parameter that is looked at
KNOWN = 1e-2, 1e2  # sizes of a parameter: an end of its interval beyond these says nothing of it


@dataclass(frozen=True)
class Identified(InNotebook):
    """Delays D (m,) with intervals of 95 % (m, 2); the parameters that were freed; errors on the held-back part.

    `identifiable` (m,) is False where the log does not tell the delay: the interval holds what it does tell. `refused`
    is True where the log contradicts the model, or a law without a test signal gave the commands: no answer counts. Of
    `held_back` each number is the rms error of a prediction over many samples, in the unit of the output that is
    measured, of several outputs in their standard deviations. `sentences` say all of it in words.
    """

    plant: Plant
    D: np.ndarray
    interval: np.ndarray
    identifiable: np.ndarray
    refused: bool
    parameters: dict[str, float]
    parameter_intervals: dict[str, tuple[float, float]]
    held_back: dict[str, float]
    sentences: list[str]
    windows: Windows | None = None
    details: dict[str, Any] = field(default_factory=dict, repr=False)

    def __str__(self) -> str:
        return "\n".join(self.sentences)


WORDS = {
    "model": "the model",
    "no_delay": "without the delay",
    "first_order_lag": "with a first-order lag in its place",
    "lag_and_delay": "with a lag behind a shorter delay",
    "static": "by constant gains alone",
}


def held_back_unit(plant: Plant, validation: Validation) -> str:
    """The unit of errors on what was held back, in words."""
    if validation.single is None:
        return "standard deviations of the outputs"
    name = plant.outputs[validation.single]
    return plant.units.get(name) or f"unit of {name}"


class Findings(Evidence):
    """What the sentences are made of."""

    @property
    def sentences(self) -> list[str]:
        """One sentence or two for each thing that is known or is not."""
        lines = self._of_model()
        for j in range(len(self.D)):
            reason = self.still[j] or self.closed > CLOSED or self.alternatives[j].explains
            lines += self._of_input(j) if reason or not self.refused else self._of_lag(j)
        if not self.silent:
            lines += self._of_rows()
            lines += [line for name in self.parameters for line in self._of_parameter(name)]
            lines += self._of_combination()
            for name, deviations in self.assumed.items():
                if abs(deviations) > ODD:
                    lines.append(
                        f"The log fits only with another value of {name}: its error is {abs(deviations):.1f} times "
                        f"`model_error`. Free it, or check it."
                    )
            if self.inflation > 2:
                lines.append(
                    f"Errors keep their sign for {self.inflation:.1f} samples: the model misses something in the log. "
                    "The intervals are widened for this, but they are valid for this model only."
                )
            if self.drift > 0:
                lines.append(
                    f"For about {self.plant.time_text(self.drift, '.3g')} at a time the plant goes one way against the "
                    "model: something acts on it that the log does not have. The intervals of parameters are widened."
                )
        errors = self.validation.errors
        if not errors:
            return [*lines, "The log is too short to hold back a part for validation."]
        rows = [("model", "delay", f"error ({held_back_unit(self.plant, self.validation)})")]
        rows += [(WORDS[name], self._delays(name), self._error(name)) for name in WORDS if name in errors]
        words, delay, _ = (max(map(len, cells)) for cells in zip(*rows, strict=True))
        many = f"{self.validation.samples} samples"
        return [
            *lines,
            f"Errors (rms) of predictions on the last quarter of the log, {many}, which was held back:",
            *(f"  {row[0]:{words}}  {row[1]:{delay}}  {row[2]}" for row in rows),
        ]

    def _delays(self, name: str) -> str:
        """The delays by which a model predicts, and its lags."""
        time = self.plant.time_text
        delays, lags = (", ".join(time(span, ".3g") for span in by.get(name, ())) for by in self.validation[-2:])
        return f"{delays}, lag {lags}" if lags else delays or "–"

    def _error(self, name: str) -> str:
        error = self.validation.errors[name]
        return f"{error:.3g}" if error < RUN_AWAY else "beyond any number (overflow)"

    def _of_model(self) -> list[str]:
        """Why there is no answer at all."""
        if not self.accurate:
            return [
                "There is no answer: the model is too fast for the samples, so that the error of its integration "
                "is unknown. Bound the parameters, or record with a shorter period."
            ]
        if self.validation.better is not None:
            return [
                "There is no answer: the held-back part contradicts the model. The error of predictions "
                f"({held_back_unit(self.plant, self.validation)}) is {self._error(self.validation.better)} "
                f"{WORDS[self.validation.better]}, and {self._error('model')} by the model. "
                "Check the plant, its units and its first values."
            ]
        return []

    def _of_input(self, j: int) -> list[str]:
        name, time, (low, high) = self.plant.inputs[j], self.plant.time_text, self.interval[j]
        if doubt := self.doubt(j):
            return f"The delay of {name} is not identifiable: {doubt}".split("\n")
        periods = f"{self.D[j] / self.period:.2f} sampling periods"
        ends = f"{time(low, '.4g')} and {time(high, '.4g')}"
        lines = [f"{name} arrives {time(self.D[j], '.4g')} late, {periods}; with 95 % between {ends}."]
        if low <= 0:
            lines.append(f"The log fits without a delay of {name}, too.")
        return lines + self._of_lag(j)

    def _of_lag(self, j: int) -> list[str]:
        if not (behind := self.alternatives[j].behind):
            return []
        delay, lag = (self.plant.time_text(span, ".3g") for span in behind)
        return [
            f"A delay of {delay} with a first-order lag of {lag} behind it fits clearly better: if there is such a "
            "lag, add a state for it to the plant."
        ]

    def _of_rows(self) -> list[str]:
        """What the commands may have done between the rows of the log."""
        lines, time = [], self.plant.time_text
        if self.lines and self.lines.alike:
            D = ", ".join(time(max(each, 0.0), ".4g") for each in self.lines.D)
            lines.append(f"Commands in straight lines fit as well, with a delay of {D}: if the log has not all the "
                         "commands, add --hold linear; if it has all of them, --hold zero.")  # fmt: skip
        if self.late.any():
            lines.append(f"Rows are missing: a command may be older than its row, in the mean by up to "
                         f"{time(self.late.max(), '.3g')}. The interval is longer by that.")  # fmt: skip
        return lines

    def _of_parameter(self, name: str) -> list[str]:
        value, low, high, correlation = self.parameters[name]
        if not np.isfinite([low, high]).all() or high - low > 10 * max(abs(value), 1e-300):
            return [f"{name} is not identifiable: the log fits {self._values(name, value, low, high)}."]
        lines = [f"{name} = {value:.4g}, with 95 % between {low:.4g} and {high:.4g}."]
        if abs(correlation) > 0.95:
            lines.append(f"The log hardly tells {name} from the delay: their errors correlate with {correlation:.2f}.")
        return lines

    def _values(self, name: str, value: float, low: float, high: float) -> str:
        """A wide interval in words; an end far from the size of the parameter, as its limit beside 0, says nothing."""
        size = max(abs(value), abs(self.plant.parameters[name]))
        ends = {"above": low, "below": high}
        near = {word: end for word, end in ends.items() if KNOWN[0] * size < abs(end) < KNOWN[1] * size}
        if len(near) == 2:
            return f"any value from {low:.3g} to {high:.3g}"
        return next((f"any value {word} {end:.3g}" for word, end in near.items()), "almost any value of it")

    def _of_combination(self) -> list[str]:
        if not self.combination:
            return []
        names, factors, value, deviation = self.combination
        parts = zip(names, factors, strict=True)
        terms = " + ".join(name if abs(f - 1) < 5e-4 else f"{f:.3g} {name}" for name, f in parts)
        sum_is = f"{terms.replace('+ -', '- ')} = {value:.4g} ± {2 * deviation:.2g}"
        return [f"Of {' and '.join(names)} only a combination is known, near these values: {sum_is}."]

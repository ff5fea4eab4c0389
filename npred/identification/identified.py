"""The answer of a log about a plant, and its limits, in numbers and in sentences."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from npred.base.notebook import InNotebook
from npred.identification.alternatives import Alternative, Validation
from npred.identification.estimate import Combination, Parameter
from npred.plants import Plant

CLOSED = 0.97  # R² by the outputs: the commands are those of a law
RUN_AWAY = 1e20  # an error that is no number for people
CERTAIN = 0.5  # share of the range of delays: a wider interval says nothing
ODD, FAR = 2.0, 4.0  # times what was allowed: a parameter that is looked at, and one that explains something else


@dataclass(frozen=True)
class Windows:
    """Delays over time: the middle t (W,) of each window, D (W, m) and its interval of 95 % (W, m, 2)."""

    t: np.ndarray
    D: np.ndarray
    interval: np.ndarray

    def sentences(self, plant: Plant, whole: np.ndarray) -> list[str]:
        """How the delays go over the windows, and whether one constant delay, of the whole log, is in all intervals."""
        lines = []
        for j, name in enumerate(plant.inputs):
            least, most = (plant.time_text(D, ".3g") for D in (self.D[:, j].min(), self.D[:, j].max()))
            inside = (self.interval[:, j, 0] <= whole[j, 1]) & (self.interval[:, j, 1] >= whole[j, 0])
            fits = "a constant delay fits all of them" if inside.all() else (
                f"in {(~inside).sum()} of them the delay is another than in the whole log")  # fmt: skip
            lines.append(f"In {len(self.t)} windows of time the delay of {name} is {least} to {most}: {fits}.")
        return lines


@dataclass(frozen=True)
class Identified(InNotebook):
    """Delays D (m,) with intervals of 95 % (m, 2); the parameters that were freed; errors on the held-back part.

    `identifiable` (m,) is False where the log does not tell the delay: the interval holds what it does tell. `refused`
    is True where the log contradicts the model, or a law without a test signal gave the commands: no answer counts. Of
    `held_back` each number is the rms error of a prediction over many samples, in the output's unit, of several outputs
    in their standard deviations. `sentences` say all of it in words.
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


RIVALS = {
    "no_delay": "without the delay",
    "first_order_lag": "with a first-order lag in its place",
    "lag_and_delay": "with a lag behind a shorter delay",
    "static": "by constant gains alone",
}


@dataclass(frozen=True)
class Findings:
    """All that the sentences are made of."""

    plant: Plant
    D: np.ndarray
    early: np.ndarray  # (m,) below zero where the log clearly fits best with an input before its command
    interval: np.ndarray
    high: np.ndarray  # (m,) the longest delays that were tried
    period: float
    alternatives: list[Alternative]
    lagged: np.ndarray  # (m,) a lag behind a delay that is far shorter fits about as well
    still: np.ndarray  # (m,) inputs that change in no recording
    alike: list[tuple[int, int]]  # inputs that move together
    recurring: np.ndarray  # (m,) after which time an input repeats itself, infinite where it does not
    parameters: Mapping[str, Parameter]
    assumed: dict[str, float]  # parameters that were not freed: how far from the plant's, in what was allowed
    combination: Combination | None
    inflation: float
    drift: float  # time for which the plant goes one way against the model, 0 for none
    accurate: bool
    several: bool  # other minima are as good
    closed: float  # how much of the commands follows the outputs, R²
    validation: Validation

    @property
    def refused(self) -> bool:
        """True if the log contradicts the model, or its rollouts are not exact."""
        return self.validation.better is not None or not self.accurate

    @property
    def silent(self) -> bool:
        """True if the log tells nothing of the delays and parameters."""
        return self.refused or self.closed > CLOSED

    @property
    def identifiable(self) -> np.ndarray:
        """(m,) True where the log tells the delay."""
        return np.array([not (self.refused or self._doubt(j)) for j in range(len(self.D))])

    @property
    def _off(self) -> bool:
        """True if the log asks for a plant that is far from the one that was given."""
        return any(abs(deviations) > FAR for deviations in self.assumed.values())

    @property
    def sentences(self) -> list[str]:
        """One sentence or two for each thing that is known or is not."""
        lines = self._of_model()
        for j in range(len(self.D)):
            reason = self.still[j] or self.closed > CLOSED or self.alternatives[j].explains
            lines += self._of_input(j) if reason or not self.refused else self._of_lag(j)
        if not self.silent:
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
        rows = {"model": "of the model", **{name: words for name, words in RIVALS.items() if name in errors}}
        width = max(map(len, rows.values()))
        return [
            *lines,
            "Errors of predictions on the last quarter of the log, which was held back (rms):",
            *(f"  {words:{width}}  {self._error(name)}" for name, words in rows.items()),
        ]

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
                "There is no answer: the held-back part contradicts the model. The error of predictions is "
                f"{self._error(self.validation.better)} {RIVALS[self.validation.better]}, and {self._error('model')} "
                f"by the model. Check the plant, its units and its first values."
            ]
        return []

    def _of_input(self, j: int) -> list[str]:
        name, time, (low, high) = self.plant.inputs[j], self.plant.time_text, self.interval[j]
        if doubt := self._doubt(j):
            return f"The delay of {name} is not identifiable: {doubt}".split("\n")
        periods = f"{self.D[j] / self.period:.2f} sampling periods"
        ends = f"{time(low, '.4g')} and {time(high, '.4g')}"
        lines = [f"{name} arrives {time(self.D[j], '.4g')} late, {periods}; with 95 % between {ends}."]
        if low <= 0:
            lines.append(f"The log fits without a delay of {name}, too.")
        return lines + self._of_lag(j)

    def _doubt(self, j: int) -> str:
        """Why the log does not tell this delay, and what to do: the first reason that holds, or "" for none."""
        name, other, time = self.plant.inputs[j], self.alternatives[j], self.plant.time_text
        best, (low, high), longest = time(self.D[j], ".3g"), self.interval[j], self.high[j]
        span = f"{time(low, '.4g')} to {time(high, '.4g')}"
        both = next((" and ".join(self.plant.inputs[i] for i in pair) for pair in self.alike if j in pair), "")
        unclear = high - low > CERTAIN * longest or (low <= 0 and high > self.period)  # none, or any up to there
        if self.still[j]:
            cure = "If a recording begins with a step, put a row with the command before it in front."
            return f"{name} never changes. Record steps of it. {cure}"
        if both:
            return f"{both} move together. Record steps of one while the other is at rest."
        if self.closed > CLOSED:
            return "the commands follow the outputs: the log is of a closed loop without a test signal. Add one."
        if self.early[j] < 0:
            first = f"the log fits best with {name} {time(-self.early[j], '.3g')} before its command. Either it is"
            cure = "logged late, or it is not constant between two rows: check the clocks, try --hold linear."
            return f"{first} {cure} Any delay of {span} is possible."
        if self._off:
            return "the plant, with its parameters, does not explain the log."
        if self.recurring[j] < longest:
            after = f"{name} repeats itself after {time(self.recurring[j], '.3g')}, so a delay is known only up to that"
            return f"{after} time: {span}. Record steps at random times."
        if self.several:
            return f"several delays of {span} fit about equally well; {best} is the best. Record steps at random times."
        if other.explains:
            lag = f"a first-order lag of {time(other.lag, '.3g')} explains the log as well as a delay of {best}, or"
            cure = f"To tell a delay from a lag, record sharp steps of {name}, with more samples after each step."
            return f"{lag} better. Any delay of {span} is possible.\n{cure}"
        if high >= longest - 1e-9 * longest:
            tried = f"the log fits {'any delay' if low <= 0 else 'delays'} of {span}, the longest that was tried."
            return f"{tried} Record larger steps of {name}, or try longer delays."
        if self.lagged[j]:
            return f"a shorter delay with a lag behind it fits about equally well: {span}. Record sharper steps."
        return f"any delay of {span} fits. Record larger steps of {name}." if unclear else ""

    def _of_lag(self, j: int) -> list[str]:
        if not (behind := self.alternatives[j].behind):
            return []
        delay, lag = (self.plant.time_text(span, ".3g") for span in behind)
        return [
            f"A delay of {delay} with a first-order lag of {lag} behind it fits clearly better: if there is such a "
            "lag, add a state for it to the plant."
        ]

    def _of_parameter(self, name: str) -> list[str]:
        value, low, high, correlation = self.parameters[name]
        if not np.isfinite([low, high]).all() or high - low > 10 * max(abs(value), 1e-300):
            above = f"any value above {low:.3g}" if 0 < 0.01 * value < low else "almost any value of it"
            return [f"{name} is not identifiable: the log fits {above}."]
        lines = [f"{name} = {value:.4g}, with 95 % between {low:.4g} and {high:.4g}."]
        if abs(correlation) > 0.95:
            lines.append(f"The log hardly tells {name} from the delay: their errors correlate with {correlation:.2f}.")
        return lines

    def _of_combination(self) -> list[str]:
        if not self.combination:
            return []
        names, factors, value, deviation = self.combination
        parts = zip(names, factors, strict=True)
        terms = " + ".join(name if abs(f - 1) < 5e-4 else f"{f:.3g} {name}" for name, f in parts)
        sum_is = f"{terms.replace('+ -', '- ')} = {value:.4g} ± {2 * deviation:.2g}"
        return [f"Of {' and '.join(names)} only a combination is known, near these values: {sum_is}."]

"""The answer of a log about a plant, and its limits, in numbers and in sentences."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from npred.base.notebook import InNotebook
from npred.identification.alternatives import Alternative
from npred.identification.estimate import Parameter
from npred.plants import Plant

CERTAIN = 0.5  # share of the range of delays: a wider interval says nothing
ODD, FAR = 2.0, 4.0  # times what was allowed: a parameter that is looked at, and one that explains something else


@dataclass(frozen=True)
class Windows:
    """Delays over time: the middle t (W,) of each window, D (W, m) and its interval of 95 % (W, m, 2)."""

    t: np.ndarray
    D: np.ndarray
    interval: np.ndarray


@dataclass(frozen=True)
class Identified(InNotebook):
    """Delays D (m,) with intervals of 95 % (m, 2); the parameters that were freed; errors on the held-back part.

    `identifiable` (m,) is False where the log does not tell the delay: the interval holds what it does tell. Of
    `held_back` each number is the rms error of a prediction over many samples, in the output's unit, of several outputs
    in their standard deviations. `sentences` say all of it in words.
    """

    plant: Plant
    D: np.ndarray
    interval: np.ndarray
    identifiable: np.ndarray
    parameters: dict[str, float]
    parameter_intervals: dict[str, tuple[float, float]]
    held_back: dict[str, float]
    sentences: list[str]
    windows: Windows | None = None
    details: dict[str, Any] = field(default_factory=dict, repr=False)

    def __str__(self) -> str:
        return "\n".join(self.sentences)


@dataclass(frozen=True)
class Findings:
    """All that the sentences are made of."""

    plant: Plant
    D: np.ndarray
    interval: np.ndarray
    high: np.ndarray  # (m,) the longest delays that were tried
    period: float
    alternatives: list[Alternative]
    still: np.ndarray  # (m,) inputs that never change
    parameters: Mapping[str, Parameter]
    assumed: dict[str, float]  # parameters that were not freed: how far from the plant's, in what was allowed
    inflation: float
    closed: float  # how much of the commands follows the outputs, R²
    held_back: dict[str, float]

    @property
    def identifiable(self) -> np.ndarray:
        """(m,) True where the log tells the delay."""
        wide = np.diff(self.interval, axis=1)[:, 0] > CERTAIN * self.high
        ends = self.interval[:, 1] >= self.high - 1e-9 * self.high
        return ~(wide | ends | self.still | self._off | np.array([a.as_good for a in self.alternatives]))

    @property
    def _off(self) -> bool:
        """True if the log asks for a plant that is far from the one that was given."""
        return any(abs(deviations) > FAR for deviations in self.assumed.values())

    @property
    def sentences(self) -> list[str]:
        """One sentence or two for each thing that is known or is not."""
        lines = [line for j in range(len(self.D)) for line in self._of_input(j)]
        lines += [line for name in self.parameters for line in self._of_parameter(name)]
        for name, deviations in self.assumed.items():
            if abs(deviations) > ODD:
                lines.append(
                    f"The log asks for another value of {name}, {abs(deviations):.1f} times as far as was allowed. "
                    f"Free it, or check it."
                )
        if self.inflation > 2:
            lines.append(
                f"Errors stay on one side for {self.inflation:.1f} samples: the model misses something in the log. "
                "The intervals are wider for it, but they hold for this model only."
            )
        if self.closed > 0.95 and not self.identifiable.all():
            lines.append("The commands follow the outputs: the log is of a closed loop without a test signal. Add one.")
        if not self.held_back:
            return [*lines, "The log is too short to hold a part of it back."]
        model, none, lag = (f"{self.held_back[name]:.3g}" for name in ("model", "no_delay", "first_order_lag"))
        lines.append(
            f"On the last quarter of the log, which was held back, predictions err by {model} (rms), without the delay "
            f"by {none}, with a first-order lag in its place by {lag}."
        )
        return lines

    def _of_input(self, j: int) -> list[str]:
        name, other, time = self.plant.inputs[j], self.alternatives[j], self.plant.time_text
        low, high = self.interval[j]
        span, ends = (f"{time(low, '.4g')} {word} {time(high, '.4g')}" for word in ("to", "and"))
        if self.still[j]:
            return [f"The delay of {name} is not identifiable: {name} never changes. Record steps of it."]
        if other.as_good:
            return [
                f"The delay of {name} is not identifiable: a first-order lag of {time(other.lag, '.3g')} explains the "
                f"log as well as a delay of {time(self.D[j], '.3g')}, or better. Any delay of {span} is possible.",
                f"Sharp steps of {name}, and samples closer to each other after them, would tell a delay from a lag.",
            ]
        if high >= self.high[j] - 1e-9 * self.high[j]:
            what = "fits any delay" if low <= 0 else "fits delays"
            return [
                f"The delay of {name} is not identifiable: the log {what} of {span}, the longest that was tried. "
                f"Record larger steps of {name}, or try longer delays."
            ]
        if self._off:
            return [f"The delay of {name} is not identifiable: the plant as it was given does not explain the log."]
        if not self.identifiable[j]:
            return [
                f"The delay of {name} is not identifiable: any delay of {span} fits. Record larger steps of {name}."
            ]
        periods = f"{self.D[j] / self.period:.2f} sampling periods"
        lines = [f"{name} arrives {time(self.D[j], '.4g')} late, {periods}; with 95 % between {ends}."]
        if low <= 0:
            lines.append(f"No delay of {name} at all fits the log as well.")
        if other.behind:
            delay, lag = (time(seconds, ".3g") for seconds in other.behind)
            lines.append(f"A delay of {delay} with a first-order lag of {lag} behind it fits clearly better.")
        return lines

    def _of_parameter(self, name: str) -> list[str]:
        value, low, high, correlation = self.parameters[name]
        if not np.isfinite([low, high]).all() or high - low > 10 * max(abs(value), 1e-300):
            return [f"{name} is not identifiable: the log fits almost any value of it."]
        lines = [f"{name} = {value:.4g}, with 95 % between {low:.4g} and {high:.4g}."]
        if abs(correlation) > 0.95:
            lines.append(f"The log hardly tells {name} from the delay: their errors correlate by {correlation:.2f}.")
        return lines

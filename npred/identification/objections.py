"""What speaks against an answer about a delay: a table of objections that take its certainty, and what widens it.

An objection is a sentence about input j, or "" where it does not hold; the first one that holds is said. `settled`
gives the least interval that holds all that was seen.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from npred.identification.alternatives import Alternative, Lines, Validation
from npred.identification.estimate import MISSING, Combination, Parameter
from npred.identification.windows import Windows
from npred.plants import Plant

CLOSED = 0.97  # R² by the outputs: the commands are those of a law
CERTAIN = 0.5  # share of the range of delays: a wider interval says nothing
FAR = 4.0  # times what was allowed: a parameter that explains something else
POOR = 0.3  # share of the spread of the outputs: so large errors that keep their sign are no noise
LONG = 5.0  # samples for which they do
DEVIATIONS = 2.0  # by which commands may arrive before and after the mean
FOLLOWING = 0.15, 0.3  # R² by commands of errors that are notable, and of any: the plant answers otherwise
NOTABLE = 0.02  # share of the spread of the outputs: smaller errors may come from between the rows


@dataclass(frozen=True)
class Evidence:
    """All that is known of the delays of a log."""

    plant: Plant
    D: np.ndarray
    early: np.ndarray  # (m,) below zero where the log clearly fits best with an input before its command
    interval: np.ndarray
    high: np.ndarray  # (m,) the longest delays that were tried
    period: float
    alternatives: list[Alternative]
    lines: Lines | None  # commands in straight lines, where they may move so
    late: np.ndarray  # (m,) how much older than their rows commands may be in the mean
    windows: Windows
    scatter: np.ndarray  # (m,) standard deviation of the delay from segment to segment, 0 if that may be chance
    varies: np.ndarray  # (m,) no constant delay fits the log and all of them
    lagged: np.ndarray  # (m,) a lag behind a delay that is far shorter fits about as well
    still: np.ndarray  # (m,) inputs that change in no recording
    alike: list[tuple[int, int]]  # inputs that move together
    recurring: np.ndarray  # (m,) after which time an input repeats itself, infinite where it does not
    parameters: Mapping[str, Parameter]
    assumed: dict[str, float]  # parameters that were not freed: how far from the plant's, in what was allowed
    combination: Combination | None
    inflation: float
    drift: float  # time for which the plant goes one way against the model, 0 for none
    share: float  # of errors that keep their sign, in the spread of the outputs
    following: float  # how much of the errors follows the commands, R²
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
    def incomplete(self) -> bool:
        """True if the plant answers commands otherwise than the model: states that this lacks may delay them, too."""
        return self.following > FOLLOWING[self.share < NOTABLE] and self.inflation > MISSING

    @property
    def identifiable(self) -> np.ndarray:
        """(m,) True where the log tells the delay."""
        return np.array([not (self.refused or self.doubt(j)) for j in range(len(self.D))])

    def doubt(self, j: int) -> str:
        """Why the log does not tell this delay, and what to do: the first objection that holds, or "" for none."""
        return next((words for objection in OBJECTIONS if (words := objection(self, j))), "")

    def span(self, j: int) -> str:
        """The interval in words."""
        low, high = (self.plant.time_text(end, ".4g") for end in self.interval[j])
        return f"{low} to {high}"


E = TypeVar("E", bound=Evidence)
Objection = Callable[[Evidence, int], str]


def still(evidence: Evidence, j: int) -> str:
    cure = "Record steps of it. If a recording begins with a step, put a row with the command before it in front."
    return f"{evidence.plant.inputs[j]} never changes. {cure}" if evidence.still[j] else ""


def together(evidence: Evidence, j: int) -> str:
    both = next((" and ".join(evidence.plant.inputs[i] for i in pair) for pair in evidence.alike if j in pair), "")
    return f"{both} move together. Record steps of one while the other is at rest." if both else ""


def closed(evidence: Evidence, j: int) -> str:
    said = "the commands follow the outputs: the log is of a closed loop without a test signal. Add one."
    return said if evidence.closed > CLOSED else ""


def before_its_command(evidence: Evidence, j: int) -> str:
    if not evidence.early[j] < 0:
        return ""
    name, early = evidence.plant.inputs[j], evidence.plant.time_text(-evidence.early[j], ".3g")
    cure = "logged late, or it is not constant between two rows: check the clocks, try --hold linear."
    said = f"the log fits best with {name} {early} before its command. Either it is {cure}"
    return f"{said} Any delay of {evidence.span(j)} is possible."


def another_plant(evidence: Evidence, j: int) -> str:
    far = any(abs(deviations) > FAR for deviations in evidence.assumed.values())
    return "the plant, with its parameters, does not explain the log." if far else ""


def recurring(evidence: Evidence, j: int) -> str:
    if not evidence.recurring[j] < evidence.high[j]:
        return ""
    after = f"{evidence.plant.inputs[j]} repeats itself after {evidence.plant.time_text(evidence.recurring[j], '.3g')}"
    return f"{after}, so a delay is known only up to that time: {evidence.span(j)}. Record steps at random times."


def more_states(evidence: Evidence, j: int) -> str:
    long = f"errors keep their sign for {evidence.inflation:.1f} samples"
    said = f"its {long}, and {evidence.following:.0%} of them follow the commands. Add the states or the mode"
    whole = f"the plant has more states than the model: {said}. Any delay of {evidence.span(j)} is possible."
    return whole if evidence.incomplete else ""


def several(evidence: Evidence, j: int) -> str:
    best = evidence.plant.time_text(evidence.D[j], ".3g")
    said = f"several delays of {evidence.span(j)} fit about equally well; {best} is the best."
    return f"{said} Record steps at random times." if evidence.several else ""


def a_lag(evidence: Evidence, j: int) -> str:
    if not (other := evidence.alternatives[j]).explains:
        return ""
    lag, best = (evidence.plant.time_text(span, ".3g") for span in (other.lag, evidence.D[j]))
    steps = f"sharp steps of {evidence.plant.inputs[j]}"
    cure = f"To tell a delay from a lag, record {steps}, with more samples after each step."
    said = f"a first-order lag of {lag} explains the log as well as a delay of {best}, or better."
    return f"{said} Any delay of {evidence.span(j)} is possible.\n{cure}"


def varying(evidence: Evidence, j: int) -> str:
    if not evidence.varies[j]:
        return ""
    telling = evidence.windows.D[evidence.windows.telling(j), j]
    D = ", ".join(evidence.plant.time_text(each, ".3g") for each in telling)
    said = f"windows of the log have different ones, in their order {D}. It changes, a clock drifts, or an actuator has"
    return f"{said} a limit: any delay of {evidence.span(j)} is possible."


def scattering(evidence: Evidence, j: int) -> str:
    time, scatter = evidence.plant.time_text, evidence.scatter[j]
    by = f"by {time(scatter, '.2g')} (standard deviation) about {time(evidence.D[j], '.3g')}"
    said = f"it differs from command to command, {by}: as on a network, or where large steps take longer than small"
    return f"{said} ones. Any delay of {evidence.span(j)} is possible." if scatter > 0 else ""


def a_lag_behind(evidence: Evidence, j: int) -> str:
    if not evidence.lagged[j]:
        return ""
    if not (behind := evidence.alternatives[j].behind):
        return (
            f"a shorter delay with a lag behind it fits about equally well: {evidence.span(j)}. Record sharper steps."
        )
    delay, lag = (evidence.plant.time_text(each, ".3g") for each in behind)
    said = f"a delay of {delay} with a first-order lag of {lag} behind it fits clearly better: {evidence.span(j)}."
    return f"{said} Add a state for the lag to the plant."


def poor(evidence: Evidence, j: int) -> str:
    long = f"errors keep their sign for {evidence.inflation:.1f} samples"
    said = f"the model is poor: its {long}, and are {evidence.share:.0%} of the spread of the outputs. Check the plant."
    return said if evidence.share > POOR and evidence.inflation > LONG else ""


def beyond(evidence: Evidence, j: int) -> str:
    longest, (low, high) = evidence.high[j], evidence.interval[j]
    tried = f"the log fits {'any delay' if low <= 0 else 'delays'} of {evidence.span(j)}, the longest that was tried."
    said = f"{tried} Record larger steps of {evidence.plant.inputs[j]}, or try longer delays."
    return said if high >= longest - 1e-9 * longest else ""


def wide(evidence: Evidence, j: int) -> str:
    low, high = evidence.interval[j]
    unclear = high - low > CERTAIN * evidence.high[j] or (
        low <= 0 and high > evidence.period
    )  # none, or any up to there
    return (
        f"any delay of {evidence.span(j)} fits. Record larger steps of {evidence.plant.inputs[j]}." if unclear else ""
    )


OBJECTIONS: tuple[Objection, ...] = (
    still, together, closed, varying, before_its_command, another_plant, recurring, more_states, several, a_lag, poor,
    beyond, scattering, a_lag_behind, wide,
)  # fmt: skip


def settled(evidence: E) -> E:
    """The same, each interval being the least one that holds all that was seen.

    An input acts after its command; if the log says before, its stamp or its samples are off by a period or so.
    """
    D, interval, period = evidence.D.copy(), evidence.interval.copy(), evidence.period
    varies, lagged = np.zeros(len(D), dtype=bool), np.zeros(len(D), dtype=bool)
    older = np.stack([0 * evidence.late, evidence.late], axis=1)  # (m, 2)
    interval, windows = interval + older, replace(evidence.windows, interval=evidence.windows.interval + older)
    for j, (ends, other, high) in enumerate(zip(interval, evidence.alternatives, evidence.high, strict=True)):
        varies[j] = windows.vary(j, ends)
        lagged[j] = bool(other.interval) and other.interval[1] + evidence.late[j] < ends[0]
        rivals = [other.interval] if other.interval else []
        rivals += [evidence.lines.interval[j]] if evidence.lines and evidence.lines.alike else []
        intervals = [
            (min(ends[0], 0.0) if other.as_good or evidence.incomplete else ends[0], ends[1]),
            *((low, top + evidence.late[j]) for low, top in rivals),
            (D[j] - (apart := DEVIATIONS * evidence.scatter[j]), min(D[j] + apart + evidence.late[j], high)),
        ]
        if varies[j]:  # what comes next is most like the last window
            over_time, D[j] = windows.seen(j)
            intervals.append(tuple(over_time))
        ends[:] = min(low for low, _ in intervals), max(top for _, top in intervals)
        D[j] += evidence.late[j] / 2
        if ends[0] < -period < 0 <= ends[1]:  # a log that cannot exclude that tells no delay
            ends[1] = max(ends[1], 1.01 * period)
        ends[:] = max(ends[0], 0.0), max(ends[1], other.lag if other.short else 0.0) if ends[1] >= 0 else period
        if (repeats := evidence.recurring[j]) < high:  # a delay is known up to that time only
            ends[:] = ends[0] - repeats * (ends[0] // repeats), ends[1] + repeats * ((high - ends[1]) // repeats)
        lagged[j] |= other.least < min(0.5 * ends[0], ends[0] - np.ptp(ends))
        if evidence.silent:
            ends[:] = 0.0, high
    evidence = replace(evidence, D=np.maximum(D, 0.0), interval=interval, windows=windows, varies=varies, lagged=lagged)
    for ends, other, certain in zip(interval, evidence.alternatives, evidence.identifiable, strict=True):
        if not certain or evidence.inflation > MISSING:  # what the model misses may be that lag
            ends[0] = min(ends[0], other.least)
    return evidence

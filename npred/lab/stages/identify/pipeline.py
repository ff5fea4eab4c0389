"""The pipeline that a recording leads to: the plant as it was identified, and loops whose times follow the recording.

Its control step dt is the recording's period / k, with the smallest k of PARTS that STEPS, FINE and the delay observer,
which is exact where samples are rarer than control steps, ask for. The delay is at least dt, for a sampled loop has
that much.
"""

import math
from os.path import relpath
from pathlib import Path
from typing import Any

import numpy as np

from npred import plants
from npred.base.errors import ConfigError
from npred.lab import config
from npred.lab.config import Pipeline
from npred.lab.config.results import IdentifiedResult
from npred.lab.config.section import map_paths
from npred.lab.scheduler import pipeline_fit
from npred.loop.control_step import FEW
from npred.plants import Plant
from npred.plants.speed import rates
from npred.prediction.delays import problem_of

STEPS = 40  # control steps in a delay that is not 0, or in a period: a controller is not that much faster than sensors
FINE = 0.1  # dt times the fastest rate of the plant, and of its loop without delay, at rest
PARTS = 1, 2, 4, 5, 8, 10, 20, 25, 40, 50, 80, 100, 200, 250, 400  # parts of a period, so that dt has few digits
SETTLED, AFTER = 10.0, 5.0  # a loop lasts so many time constants of its slowest rate, then so many delays
LEAST, MOST = 100, 10_000  # control steps of a loop
SLOWEST = 1_000_000  # control steps until a loop settles: beyond that, and beyond PARTS, a unit is wrong
WORST = 0.9  # place in an accepted range: at its very end a delay law cannot tell that the delay is inside
NODE = 0.5  # a step of the prediction, times the fastest rate
START = 0.75  # place in the box: rest is in its middle, often


def composed(asked: Pipeline, plant: Plant, result: IdentifiedResult, path: Path) -> tuple[dict[str, Any], list[str]]:
    """The tables of the pipeline at `path`, and remarks in sentences: what was chosen, and why.

    `asked` is the pipeline of the recording. A delay that is not identifiable is the range that its interval leaves.
    Raises ConfigError where `npred plants check` would say no of the pipeline: then no such file runs.
    """
    remarks, law = [], asked.kappa
    if not (law or plant.declares_kappa):
        law, remarks = "lqr", ["The plant has no kappa, so the law is LQR's."]
    values = asked.parameters | {k: v for k, v in result.parameters.items() if k in plant.parameters}
    plant = plants.resolve(asked.plant, values, law)
    ends, time = np.array(result.interval), plant.time_text
    begin = np.clip(result.windows["D"][-1], *ends.T) if result.windows else ends.mean(axis=1)
    delays = np.maximum(np.where(result.identifiable, result.D, begin), 0.0)
    longest = int(delays.argmax())
    observed = problem_of(plant).refusal("observer") is None

    fast, _, slow = rates(plant) if plant.rests or plant.tracks else (0.0, 0.0, 0.0)
    certain = result.identifiable[longest]
    none = delays[longest] <= 0 or (certain and ends[longest, 0] <= 0)  # no delay at all fits as well
    period = float(f"{result.period:.3g}")
    parts = max(0.0 if none else min(period / delays[longest], 1.0) * STEPS, fast * period / FINE, 2.0 * observed)
    k = next((k for k in PARTS if k >= parts), math.inf)
    dt = _short(period / k) or period  # 0 is refused below
    by = f", {time(period)}, by {k}" if k > 1 else ""
    remarks.append(f"The control step is {time(dt)}: the recording's period{by}.")
    low, high = (_short(max(end, dt)) for end in ends[longest])
    D_hat = D = min(max(_short(delays[longest]), low), high)
    if not certain:
        D, span = _short(low + WORST * (high - low)), f"{time(low)} to {time(high)}"
        remarks.append(f"The delay is not identifiable, and was accepted as a range: D_hat is within {span}.")
        where = "at that of the last window" if result.windows else "in the middle"
        remarks.append(f"It begins {where}, {time(D_hat)}; the simulated delay is near the long end, {time(D)}.")
    for j, name in enumerate(plant.inputs):
        if j != longest and not result.identifiable[j]:
            which = "that of the last window" if result.windows else "the middle of its range"
            remarks.append(f"The delay of {name} is not identifiable: it is {which}, {time(delays[j], '.4g')}.")
    if delays[longest] < dt:
        remarks.append(f"The delay is shorter than a control step, the least that a loop can have: D = {time(D)}.")
    if not observed:
        remarks.append("The delay observer does not work for this plant, so D_hat is constant.")
    elif D_hat < FEW * dt * (1 - 1e-9):
        observed = False
        remarks.append(f"A delay of fewer than {FEW} control steps is too short to be estimated, so D_hat is constant.")
    differ = plant.m > 1 and (not plant.one_delay or np.ptp(delays) >= dt)
    if differ:
        each = ", ".join(f"{name} {time(_short(d))}" for name, d in zip(plant.inputs, delays, strict=True))
        one = (
            "D and D_hat are the longest; the others move with it." if plant.traced else "A black box has the longest."
        )
        remarks.append(f"The inputs have different delays: {each}. {one}")

    settled = SETTLED / slow / dt if slow > 0 else 0.0
    if k > PARTS[-1] or settled > SLOWEST:
        came = f"rates of {slow:.3g} to {fast:.3g} per {plant.time_unit}, and a sample each {time(period)}"
        todo = "check the units, and the parameters"
        raise ConfigError(f"plant {plant.name}: expected rates that samples show, got {came}; {todo}")
    if settled > MOST:
        long = time(SETTLED / slow, ".3g")
        remarks.append(f"The slowest rate of the loop, {slow:.3g}, would take {long}; loops are shorter.")
    steps = math.ceil(max(min(settled, MOST) + AFTER * high / dt, LEAST))
    t_end, finer = _short(steps * dt), math.ceil(fast * high / (50 * NODE))  # 50 intervals of [evaluate]
    boxes = {name: result.ranges[name] for name in plant.states if name not in plant.box and name in result.ranges}
    ranges = plant.box | ({} if plant.declares_output else boxes)
    measured = [name for name in plant.outputs if name in result.ranges]
    loop: dict[str, Any] = {"D": D, "dt": dt, "t_end": t_end, "actuator": "history"}
    loop |= {"adaptation": "delay-observer", "bounds": [low, high]} if observed else {"adaptation": "frozen"}
    loop |= {"measurement": {"period": period}} if k > 1 else {}
    if plant.declares_output or len(measured) < plant.n:
        loop |= {"observer": {"kind": "ekf"} | ({} if plant.declares_output else {"outputs": measured})}
    start = [ranges[s][0] + START * (ranges[s][1] - ranges[s][0]) if s in ranges else float(x)
             for s, x in zip(plant.states, plant.guess, strict=True)]  # fmt: skip
    whole = [max(low, _short(FEW * dt)) if observed else low, high] if D_hat < D else D
    generate = loop | {"D": whole, "D_hat": [[low, high]]} | ({"nx": 100 * finer + 1} if finer > 1 else {})
    generate |= {"box": boxes} if ranges.keys() > plant.box.keys() else {}
    evaluate = loop | {"D_hat": D_hat, "case_D_hat": sorted({low, D_hat, high}), "case_t_end": t_end, "X0": start}
    evaluate |= {"nx": 50 * finer + 1} if finer > 1 else {}
    plant_file = {"plant": asked.plant, "kappa": law or None}
    here = map_paths(plant_file, lambda file: file if Path(file).is_absolute() else relpath(file, path.parent))
    tables = {"name": asked.name, **here, "parameters": values, "generate": generate, "evaluate": evaluate}
    if differ and plant.traced:
        tables["delays"] = [_short(max(d, dt)) for d in delays]
    kept = {key: value for key, value in (tables | {"plant": asked.plant}).items() if value}
    pipeline = config.parse(kept, str(path))
    for answer in pipeline_fit.check(plants.resolve(*pipeline.of_plant), pipeline):
        if answer.verdict == "no":
            raise ConfigError(f"npred plants check would say no for {answer.check}: {answer.text}")
    return tables, remarks


def _short(number: float) -> float:
    return float(f"{number:.6g}")

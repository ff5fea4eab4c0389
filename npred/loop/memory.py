"""What a controller remembers from call to call: its signals, its commands, the clock of its calls, and the time."""

import math
import operator
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from npred.base import array_checks
from npred.base.errors import ConfigError
from npred.estimation.delay_law import Part
from npred.loop import assembly, settable, signals
from npred.loop.actuator import history
from npred.loop.clock import Clock
from npred.loop.loop import Loop
from npred.loop.signals import Settings
from npred.loop.timing import ROUNDING
from npred.plants.inputs import Past

STEPS = 2**53  # beyond it a float64, as step * dt is one, no longer counts one by one


class Memory:
    """The memory of one controller of a loop that is complete, with the commands `past` before its first call."""

    def __init__(self, loop: Loop, laws: Part, settings: Settings, past: Past) -> None:
        self.loop, self.plant, self.settings = loop, loop.plant, settings
        self.watches = laws.memory > 1  # an observer of the delay looks on
        self.keeps_commands = loop.reads_commands or self.watches  # a step reads the commands of those before it
        self.longest, self.oldest = assembly.history_length(loop, laws.bounds), int(settings.oldest)
        self.kept_for = self.longest  # how long commands are kept
        if self.oldest:
            self.kept_for = (int(self.longest / loop.dt) + self.oldest + 0.5) * loop.dt
        sizes = assembly.sizes(loop, laws)
        n, m, nx, reads = sizes["n"], sizes["m"], sizes["nx"], loop.reads_commands
        held, total = history(self.kept_for, self.kept_for, loop.dt, past)[1:]
        self.clock, Y = Clock(n, m, sizes["outputs"]), np.zeros((n, 1))
        arrays = {"Y": Y, "X_hat": np.zeros((n, 1)) if reads else Y, "held": held, "total": total}
        arrays |= {"u": np.zeros((nx, m, 1)), "u_nodes": np.zeros((nx, m, 1)), "D_seen": np.zeros((m, 1))}
        arrays |= {"error": np.full(1, np.nan), "clock": self.clock.memory[:, None]}
        if loop.observer:
            arrays |= {"filter": np.array(loop.observer.start(), dtype=float)[:, None]}
        self.signals = signals.State(**signals.memory(signals.STATE, sizes, 1, arrays))
        self.set(loop.D_hat or 0.0, None, 0, 0.0)
        self.reset_clock()

    @property
    def D_hat(self) -> float:
        """The estimate that the next step uses."""
        return float(self.signals.D_hat[0])

    @property
    def t(self) -> float:
        """The time of the next step."""
        return self.t0 + self.step * self.loop.dt

    @property
    def reach(self) -> float:
        """How far back its commands are kept."""
        return (len(self.signals.held) - 4 - self.oldest) * self.loop.dt

    @property
    def longest_D_hat(self) -> float:
        """The longest delay by which a step can read its commands."""
        return (len(self.signals.held) - 3 - self.oldest) * self.loop.dt

    @property
    def _next(self) -> int:
        """The control step of the next call, in the history."""
        return int(self.clock["at"] + ROUNDING) + 1

    @property
    def parameters(self) -> dict[str, float]:
        """All that the plant's functions read as p, by name."""
        return dict(zip(self.plant.p_names, self.settings.p.tolist(), strict=True))

    @cached_property
    def fixed(self) -> dict[str, str]:
        """Why a parameter cannot be set, by its name."""
        assert self.loop.predictor is not None
        return settable.fixed(self.plant, self.loop.predictor)

    def begin(self, past: Past) -> None:
        """Take these commands for those before the first call."""
        z = self.signals
        _, z.held[:], z.total[:] = history(self.kept_for, self.kept_for, self.loop.dt, past)
        self.reset_clock()

    def reset_clock(self, k: int | None = None, calls: int = 0) -> None:
        """Set the clock before the call of control step k, the first by default."""
        held = self.signals.held
        k = len(held) - 1 if k is None else k
        X_hat = self.signals.filter[: self.plant.n, 0] if self.loop.observer else None
        self.clock.start(k, held[(k - 1) % len(held), :, 0], self.plant.ratios * self.D_hat, X_hat, calls)

    def state(self) -> dict[str, Any]:
        """D_hat, phi of the last step, the steps done since t0, and what else it has, ready for JSON."""
        z, phi = self.signals, float(self.signals.phi_before[0])
        remembered: dict[str, Any] = {}
        if self.keeps_commands:
            held, sums = z.held[:, :, 0].tolist(), z.total[:, :, 0].tolist()
            remembered = {"commands": {"k": self._next, "held": held, "sums": sums}, "clock": self.clock.state()}
        if self.loop.reads_commands:
            remembered["missed"] = int(z.missed[0])
        if z.filter.size:
            remembered["filter"] = z.filter[:, 0].tolist()
        if z.plan.size:
            remembered["plan"] = z.plan[:, 0].tolist()
        if self.watches:
            remembered["observer"] = [None if math.isnan(value) else value for value in z.observer[:, 0].tolist()]
        if self.plant.p_names:
            remembered["parameters"] = self.parameters
        rate = None if math.isnan(phi) else phi
        return {"D_hat": self.D_hat, "phi": rate, "step": self.step, "t0": self.t0} | remembered

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a saved state; without phi as from a first step, without t0 from 0. Raises ConfigError if none."""
        try:
            D_hat, step = state["D_hat"], operator.index(state["step"])
            phi, t0 = state.get("phi"), state.get("t0", 0.0)
        except (AttributeError, KeyError, TypeError, ValueError):
            raise ConfigError(f"state: expected D_hat and step, got {state!r}; save it with state()") from None
        before = self.state()
        self._recall(state)
        try:
            self.set(D_hat, phi, step, t0)
        except ConfigError:
            self._recall(before)
            raise

    def _recall(self, state: Mapping[str, Any]) -> None:
        """Take the commands and the observer of a saved state, where it has them. Raises ConfigError for others."""
        z = self.signals
        commands = state.get("commands", {"k": self._next, "held": z.held[:, :, 0], "sums": z.total[:, :, 0]})
        missed, clock = state.get("missed", 0), state.get("clock")
        parameters = state.get("parameters", self.parameters)
        observer = [math.nan if value is None else value for value in state.get("observer", z.observer[:, 0])]
        try:
            k, held, sums = operator.index(commands["k"]), np.array(commands["held"]), np.array(commands["sums"])
            fits = held.shape == sums.shape and held.shape[1:] == (self.plant.m,) and len(observer) == len(z.observer)
            fits = fits and len(held) <= k + 1 <= 2 * len(held) and operator.index(missed) >= 0
            filtered = np.array(state.get("filter", z.filter[:, 0]), dtype=float)
            plan = np.array(state.get("plan", np.zeros(len(z.plan))), dtype=float)
            if parameters != (before := self.parameters):
                fits = fits and [*parameters] == [*before] and np.isfinite([*parameters.values()]).all()
                fits = fits and all(parameters[name] == before[name] for name in self.fixed)
            for one, memory in ((filtered, z.filter), (plan, z.plan)):
                fits = fits and one.shape == memory[:, 0].shape and np.isfinite(one).all()
            if clock is not None:
                Clock(self.plant.n, self.plant.m, len(z.sample)).restore(clock)
        except (AttributeError, KeyError, TypeError, ValueError):
            fits = False
        if not fits:
            raise ConfigError("state: expected the commands of such a controller, got others; save it with state()")
        self.settings.p[:] = [*parameters.values()]
        z.observer[:, 0], z.filter[:, 0], z.plan[:, 0], z.missed[0] = observer, filtered, plan, missed
        held, sums = held[:, :, None].astype(float), sums[:, :, None].astype(float)  # maybe longer than those before
        self.signals = z._replace(held=np.ascontiguousarray(held), total=np.ascontiguousarray(sums))
        if clock is None:  # saved without one, by a block of python-control say
            self.reset_clock(k, int(state["step"] > 0))
        else:
            self.clock.restore(clock)
        if self.watches and math.isnan(observer[-1]):  # observers of the delay start at a sample that is believed
            self.clock.now[:] = np.nan

    def set(self, D_hat: Any, phi: Any, step: int, t0: Any) -> None:
        """Set the state of the next step, phi None for none. Raises ConfigError, and stays as it is, if wrong."""
        seconds, start = array_checks.number("D_hat", D_hat), array_checks.number("t", t0)
        rate, text = math.nan if phi is None else array_checks.number("phi", phi), self.plant.time_text
        array_checks.within("D_hat", np.array(seconds), tuple(self.settings.bounds), self.plant.time_unit)
        if self.loop.reads_commands and seconds > self.longest_D_hat:
            what = f"expected at most {text(self.longest_D_hat)}, as far as the history reaches"
            raise ConfigError(f"D_hat: {what}, got {text(seconds)}; make another controller with that D_hat")
        if not 0 <= step <= STEPS:
            came = "a negative one" if step < 0 else "a larger one"
            raise ConfigError(f"step: expected a whole number of 0 to 2^53, got {came}; save it with state()")
        if not math.isfinite(start + step * self.loop.dt):
            raise ConfigError(f"t: expected a finite time, got {start:g} and {step} steps; give a finite one")
        if math.isinf(rate):
            raise ConfigError("phi: expected a finite number or none, got infinity; save it with state()")
        z = self.signals
        z.D_hat[0], z.phi_before[0], self.step, self.t0 = seconds, rate, step, start

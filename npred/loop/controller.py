"""The controller alone, for a real plant: one control step per call, on memory taken at the start."""

import hashlib
import json
import math
import operator
from collections.abc import Mapping
from functools import cached_property
from typing import Any, Unpack

import numpy as np

from npred import plants
from npred.base import array_checks, source_lines
from npred.base.errors import ConfigError, DivergedError, unlisted
from npred.base.notebook import InNotebook
from npred.base.progress import say
from npred.estimation.delay_law import Adaptation, DelayLaw, Part, part
from npred.estimation.observers.base import SIGMAS
from npred.loop import control_step, engine, settable, signals
from npred.loop.acts import HISTORY
from npred.loop.actuator import history
from npred.loop.clock import Clock
from npred.loop.engine import Engine
from npred.loop.loop import ControllerParts, Loop
from npred.loop.status import Status
from npred.loop.timing import ROUNDING, SNAP, snapped
from npred.plants import inputs, setpoint
from npred.plants.base import Plant
from npred.prediction.delays import problem_of
from npred.prediction.methods import RK4, Predictor

HELD = "keep the actuator at the last U and pass the next sample"
DELAYS = 5.0  # times the delay at a plant's target, where it declares one, are commands kept
OLDEST = 20  # control steps, by default the largest age of a sample
STEPS = 2**53  # beyond it a float64, as step * dt is one, no longer counts one by one


def controller(
    plant: Plant, predictor: Predictor, adaptation: DelayLaw | Adaptation | str | None, dt: float, *,
    D_hat: float | None = None, **parts: Unpack[ControllerParts],
) -> "Controller":  # fmt: skip
    """The controller alone, for a real plant: `U = controller.step(X)` each dt.

    Hardware does not measure the actuator state u, so the controller reads it at D_hat from its commands; with
    `actuator="measured"`, the article's setting and the default of simulate, it is `controller.step(X, u)`.

    Parameters
    ----------
    plant : Plant
        From npred.plant.
    predictor : Predictor
        From npred.predictor, npred.load or npred.guarded.
    adaptation : DelayLaw, its name as "delay-observer", or None
        Law of the estimate D_hat; None or "frozen" freezes it, as for a plant that declares its delay.
    dt : float, in the plant's unit of time
        Control step; U is held over it.
    D_hat : float, in the plant's unit of time, optional
        First estimate of the delay; by default the middle of the law's bounds. None for a plant that declares it.
    **parts
        The other parts of npred.Loop that a controller has: input_bounds, u0, actuator (by default "history"),
        observer, watchdog, safety, outlier_limit, max_sample_age, history_length. What it needs is said there.

    Returns
    -------
    Controller
        U = kappa(P(1)), P from the predictor, each dt.

    Raises
    ------
    ConfigError
        For parts that do not fit, or that are unknown, or without what they need.
    """
    named = {"plant": plant, "predictor": predictor, "adaptation": adaptation, "dt": dt, "D_hat": D_hat}
    return Controller(Loop.of("controller", ("X0",), named | {"actuator": HISTORY} | {**parts}))


class Controller(InNotebook):
    """U = kappa(P(1)), P from the predictor, and D_hat' = gamma Proj{D_hat, phi} [DAPF, eqs. 9-14], each dt.

    With `actuator="measured"` each step is given u, so D_hat, phi of the last step and the time are all that it
    remembers; with "history" it remembers its own commands and reads u from them at D_hat. Those before the first
    step are u0, as npred.simulate has it: numbers (m,), a history over [-D_hat, 0], or a word; "law" is kappa of
    the first X. By default they are those of the plant's rest (npred.plants.inputs.start). `D_hat` is the estimate
    that the next step uses, by default the middle of the adaptation's bounds. Where `input_bounds` leave U free, it
    is clipped to npred.plants.inputs.widest. Steps equal those of npred.simulate up to rounding, and those of its
    export in C to the bit. Its memory is not shared, so one controller belongs to one thread; a pickled one goes on
    where it stood.

    With "history" the model predicts X now, X_hat, from the last sample and the commands. A sample is refused if in
    any state it is farther from X_hat than `outlier_limit` times half the box, or times the smaller of |X_hat| and
    |sample| if that is more. X_hat then takes its place, `missed` counts it, and an observer of the delay goes on
    without it; beside an observer of the state it judges outputs, those of refused samples too. If
    samples are refused for a time of D_hat, or after a doubtful one for longer than it was believed, X has jumped:
    the next one is accepted within six half widths of the box's middle, and ten times as far after each further
    D_hat. `outlier_limit=None` accepts all; so does a state without a box.

    With "history" a call may also come at any time `t`, without a sample, or with one that was taken up to
    `max_sample_age` ago (20 control steps by default): X_hat is the model's state from the last sample on.
    `observer`, one of npred.observers, estimates X from the plant's outputs, of which `step` then gets the samples; it
    accepts an output within 6 `outlier_limit` standard deviations (EKF), or `outlier_limit` half ranges (Luenberger),
    and restarts if it refused one for a time of D_hat. `watchdog` gives U if no sample comes (npred.Watchdog).
    `safety` keeps the limits that the plant declares (npred.SafetyFilter); with an uncertain delay it needs "history".

    Raises ConfigError for parts that do not fit together.
    """

    def __init__(self, loop: Loop) -> None:
        plant, predictor, law = loop.plant, loop.predictor, loop.adaptation
        if predictor is None:
            raise ConfigError("predictor: expected one, got None; make one with npred.predictor or npred.load")
        dt, gate = array_checks.number("dt", loop.dt), loop.outlier_limit
        age = OLDEST * dt if loop.max_sample_age is None else loop.max_sample_age
        self._oldest = math.floor(age / dt * (1 + 1e-12)) if loop.reads_commands else 0  # in control steps
        law, D_hat = self._first_estimate(loop)
        limits = inputs.bounds(plant, loop.input_bounds)
        u0 = inputs.start(plant, loop.u0, limits)
        self._loop = loop.filled(dt=dt, adaptation=law, input_bounds=limits, u0=u0)
        self.plant, self.predictor, self.adaptation, self.dt, self.actuator = plant, predictor, law, dt, loop.actuator
        self.outlier_limit, self.observer, self.watchdog, self.safety = gate, loop.observer, loop.watchdog, loop.safety
        kernels = part(plant, law, dt, loop.observer)
        self._reads_commands, self._watches = loop.reads_commands, kernels.memory > 1
        self.keeps_commands = self._reads_commands or self._watches  # a step reads the commands of those before it
        self._by_law = isinstance(u0, str) and u0 == inputs.LAW
        self.parts, self.settings = self._kernels(kernels), self._set(kernels)
        array_checks.within(
            "D_hat", np.array(array_checks.number("D_hat", D_hat)), tuple(kernels.bounds), plant.time_unit
        )
        if not plant.declares_delay:
            longest = D_hat if law is None else law.bounds[1]
            if law is not None:
                control_step.check("dt", dt, longest)
            if text := control_step.doubt("dt", dt, longest, plant, law is not None):
                say(text)
        self._first_D_hat, self._awaits_X = D_hat, False
        self._take_memory(kernels.memory, D_hat)
        self._set_state(D_hat, None, 0, 0.0)
        self._reset_clock()
        self._warm_up()
        self._awaits_X = self._by_law  # for the commands before the first step

    @staticmethod
    def _first_estimate(loop: Loop) -> tuple[DelayLaw | None, float]:
        """The law, complete, for a delay of D_hat or else of the middle of its bounds; and the first D_hat."""
        plant, law, D_hat = loop.plant, loop.adaptation, loop.D_hat
        if law is not None:
            if D_hat is None and law.bounds is None:
                what = "expected a first estimate, for the law has no bounds, got none"
                raise ConfigError(f"D_hat: {what}; give D_hat")
            D = np.array(array_checks.number("D_hat", sum(law.bounds) / 2 if D_hat is None else D_hat))
            array_checks.delays("D_hat", D)
            law = law.suited(plant, D, D)
        elif D_hat is None and not plant.declares_delay:
            what = f"expected a delay in {plant.time_unit}, for nothing adapts it, got none"
            raise ConfigError(f"D_hat: {what}; give D_hat")
        if D_hat is None:
            D_hat = 0.0 if law is None or plant.declares_delay else sum(law.bounds) / 2
        return law, D_hat

    def _kernels(self, law: Part) -> dict[str, Any]:
        observer, watchdog = self.observer, self.watchdog
        return {
            "observe": law.observe, "model_delay": problem_of(self.plant).horizon(), "predict": self.predictor.lanes(),
            "guard": self.predictor.guard, "control": law.control, "update": law.update,
            "model": engine.advance_kernel(self.plant, RK4) if self._reads_commands else None,
            "follow": observer and observer.follow, "correct": observer and observer.correct,
            "watchdog_law": watchdog and watchdog.law(self.plant),
            "protect": self.safety and self.safety.kernel(self.plant),
        }  # fmt: skip

    def _set(self, law: Part) -> signals.Settings:
        plant, observer, watchdog, gate = self.plant, self.observer, self.watchdog, self.outlier_limit
        limits, guard = self._loop.input_bounds, self.predictor.settings
        low, high = box = np.array([plant.box.get(name, (0.0, 0.0)) for name in plant.states]).T  # zeros for no range
        parts: dict[str, Any] = {"anew": box.mean(axis=0)}
        if observer:
            memory, widens = observer.anew()
            parts |= {
                "sensing": observer.settings, "judges_outputs": self._watches,
                "pulls": observer.pulls, "offsets": observer.offset,
                "filter_count": len(memory), "anew": memory, "widens": widens,
            }  # fmt: skip
        if watchdog:
            parts |= {
                "watched": True, "after": watchdog.after, "holds": watchdog.holds, "rescue": watchdog.rescue(plant.m),
                "jump": watchdog.jumps(plant.m),
            }  # fmt: skip
        if self.safety:
            parts |= self.safety.settings(self.plant, self.dt, limits)
        return signals.settings(
            dt=self.dt, b=law.b, gamma_dt=law.gamma * self.dt,
            reads_commands=self._reads_commands, stores_commands=self._reads_commands,
            gate=(gate or 1.0) * (SIGMAS if observer else 1.0), gated=self._reads_commands and gate is not None,
            observer_count=law.memory if self._watches else 0, oldest=float(self._oldest),
            output_count=len(self.outputs), bounds=law.bounds, p=plant.p.copy(), truth_p=plant.p, ratios=plant.ratios,
            input_bounds=np.ascontiguousarray(inputs.widest(plant, limits), dtype=float), law=law.settings,
            guard=np.zeros(0) if guard is None else guard,
            reach=(gate or 1.0) * np.where(high > low, (high - low) / 2, np.inf), **parts,
        )  # fmt: skip

    @property
    def D_hat(self) -> float:
        """The delay estimate of the next step. Set it within the adaptation's bounds, else ConfigError.

        D_hat goes on from there as from a first step, without phi of the last one.
        """
        return float(self.memory.D_hat[0])

    @D_hat.setter
    def D_hat(self, seconds: float) -> None:
        self._set_state(seconds, None, self._step, self._t0)

    @property
    def t(self) -> float:
        """The time of the next step, which a plant that depends on time reads: 0 at the start.

        Each step adds dt. Set it to go on from another time, finite, else ConfigError, as from a first step.
        """
        return self._t0 + self._step * self.dt

    @t.setter
    def t(self, seconds: float) -> None:
        self._set_state(self.D_hat, None, 0, seconds)
        self._clock.forget()
        self.memory.missed[0] = 0.0

    @property
    def parameters(self) -> dict[str, float]:
        """The plant's parameters as the next step reads them, a copy; see `set`."""
        return dict(zip(self.plant.parameters, self.settings.p.tolist(), strict=False))

    @cached_property
    def fixed(self) -> dict[str, str]:
        """Why a parameter cannot be set, by its name."""
        return settable.fixed(self.plant, self.predictor)

    @cached_property
    def _rest_bounds(self) -> np.ndarray:
        return setpoint.bounds(self.plant, self.settings.input_bounds)

    def set(self, **parameters: float) -> None:
        """Set parameters of the plant, a set-point say, that the controller reads from the next step on.

        Where the plant declares `setpoint`, its rest X*, U* is followed from the last one, by at most 500 of Newton's
        corrections; where it is refused, up to 17 times as many look for another branch, which the message names. A law
        of npred.laws then leads to it, with the gains of the set-point that was declared. In that step U moves as in
        any other, and by the difference that the new set-point makes to kappa(P). One line says where the rest breaks
        a limit of the plant's `safe`. `controller.plant` stays as it was declared; `state()` has what was set, and an
        export begins with it.

        Parameters
        ----------
        **parameters : float
            New values by name; all, or none of them is set.

        Raises
        ------
        ConfigError
            For an unknown name, a value that is not finite, a parameter that a network was trained with, or a law
            designed, and a set-point to which no rest follows within the input bounds and `state_bounds`. Then all
            stays as it was.
        """
        free = [name for name in self.plant.parameters if name not in self.fixed]
        for name, value in parameters.items():
            if name not in self.plant.parameters:
                raise ConfigError(unlisted("set", name, free, "a parameter,"))
            array_checks.finite(f"set: {name}", np.array(array_checks.number(f"set: {name}", value)))
        self.settings.p[:] = setpoint.changed(self.plant, self.settings.p, parameters, self.fixed, self._rest_bounds)

    @property
    def u0(self) -> np.ndarray:
        """The command before the first step, (m,). Raises ConfigError where it is a history, or kappa of the first
        X."""
        if self._by_law:
            raise ConfigError("u0: expected a constant command, got that of the first X; give numbers")
        return inputs.before(self.plant, self._loop.u0, self._loop.input_bounds, np.zeros((1, self.plant.n)))[0]

    @property
    def reach(self) -> float:
        """How far back its commands are kept."""
        return (len(self.memory.held) - 4 - self._oldest) * self.dt

    @property
    def longest_D_hat(self) -> float:
        """The longest delay by which a step can read its commands."""
        return (len(self.memory.held) - 3 - self._oldest) * self.dt

    @property
    def outputs(self) -> tuple[str, ...]:
        """The names of a sample's numbers: the states, or the outputs of its observer."""
        return tuple(self.observer.outputs) if self.observer else self.plant.states

    @property
    def X_hat(self) -> np.ndarray:
        """The state that the last step predicted from, (n,), a copy: the sample, or the model's state since."""
        return self.memory.X_hat[:, 0].copy()

    @property
    def status(self) -> Status:
        """The events of the last step (npred.loop.status)."""
        z, clock, m = self.memory, self._clock, self.plant.m
        age, spread = (clock["at"] - clock["sample_at"]) * self.dt, math.nan
        if self._watches:
            spread = float(engine.spreads(m, self.settings.law, z.observer, z.D_hat)[0])
        offset = z.filter[self.plant.n : self.plant.n + m, 0].copy() if self.settings.offsets else np.zeros(m)
        low, high = self.adaptation.ends(self.dt) if self.adaptation else (-math.inf, math.inf)
        return Status(
            D_hat=self.D_hat, D_hat_spread=spread, at_bound=low < high and not low < self.D_hat < high,
            age=math.inf if math.isnan(age) else age,
            innovation=z.innovation[:, 0].copy(), late=int(clock["late"]), refused=int(clock["refused"]),
            missed=int(z.missed[0]), renewed=int(clock["renewed"]), handed_over=clock["handed"] > 0, offset=offset,
            fallback=bool(z.fallback[0]), error=float(z.error[0]), filtered=z.filtered[0] > 0,
            kept=float(z.kept[0]) if self.safety else math.nan, unkept=z.unkept[0] > 0,
        )  # fmt: skip

    @property
    def P(self) -> np.ndarray:
        """The prediction of the last step on the predictor's nodes, (nx, n), a copy; NaN before the first step."""
        return self._last_P.copy()

    def step(
        self, X: Any = None, u: Any = None, u_nodes: Any = None, *, t: float | None = None,
        sampled_at: float | None = None, applied: Any = None,
    ) -> np.ndarray:  # fmt: skip
        """U (m,) for the state X (n,) and the actuator state u (nx, m) on the predictor's nodes, both measured now.

        The predictor integrates u, of which the update law compares the values at the nodes with kappa(P). `t`,
        `sampled_at` and `applied` are for actuator="history". After a DivergedError keep the actuator at the last U:
        the controller assumes so, and its time goes on; nothing else has changed.

        Parameters
        ----------
        X : (n,), optional
            State, or the outputs of the observer, NaN where one is missing; None is no sample, with actuator="history"
            only.
        u : (nx, m), optional
            Inputs under way on the predictor's nodes, measured now; none with actuator="history".
        u_nodes : (nx, m), optional
            Values of u at the nodes, where u has the means over the cells and a measurement tells them apart; by
            default u.
        t : float, in the plant's unit of time, optional
            When this call is; by default dt after the last one.
        sampled_at : float, in the plant's unit of time, optional
            When X was taken; by default now.
        applied : (m,), optional
            What the actuator got at the call before, if that was not U.

        Returns
        -------
        numpy.ndarray
            U, the controller's own memory, overwritten by the next step.

        Raises
        ------
        ConfigError
            For shapes and times that do not fit and for what are no real numbers, masked arrays among them.
        DivergedError
            For a measurement that is not finite, or from which the prediction overflows.
        """
        if (u is None) != self._reads_commands or (X is None and not self._reads_commands):
            expected, came = "X alone", "u too"
            if not self._reads_commands:
                expected, came = "X and u", "u alone" if X is None else "X alone"
            what = f"expected {expected}, for the actuator is {self.actuator!r}, got {came}"
            raise ConfigError(f"step: {what}; give what is measured")
        now, gap, age = self._times(t, sampled_at)
        if applied is not None and not self.keeps_commands:
            what = "expected a controller that reads u from its commands, got one that is given u"
            raise ConfigError(f"applied: {what}; omit it")
        sent = None if applied is None else array_checks.floats("applied", applied)
        if sent is not None and (sent.shape != (self.plant.m,) or not np.isfinite(sent).all()):
            what = f"expected {self.plant.m} finite numbers, one per input"
            raise ConfigError(f"applied: {what}, got {applied!r}; give U")
        came = X is not None
        if came:
            self._measure(array_checks.floats("X", X), u, u_nodes)
        before = None
        if self._awaits_X:
            if not came or not np.isfinite(self._Y).all():
                got = "one that is not" if came else "none"
                raise DivergedError(f"step: expected a finite first X, for u0 is kappa of it, got {got}; {HELD}")
            before = self._remembered()
            past = self._past(self._Y)
            _, self.memory.held[:], self.memory.total[:] = history(self._kept_for, self._kept_for, self.dt, past)
            self._reset_clock()
        if sent is not None:
            self._engine.replace(sent)
        code = self._engine.call(now, gap, came, age)
        if code and before is not None:  # nothing was sent, and the commands before the first X are not known
            self.restore(before)
            raise DivergedError(self._refusal(code, came, age, booked=False))
        if abs(now - self.t) > SNAP * self.dt:
            self._t0, self._step = now, 0
        self._step += 1
        if code:
            raise DivergedError(self._refusal(code, came, age, booked=self.keeps_commands))
        self._awaits_X = False
        self._last_P[:], self._last_U[:] = self._P, self._U
        return self._last_U

    def state(self) -> dict[str, Any]:
        """Its state, ready for JSON: D_hat, phi of the last step, the steps done since t0, and, as it has
        them, commands, observers and parameters; and of which plant it is."""
        return {"plant": self._formulas} | self._remembered()

    def _remembered(self) -> dict[str, Any]:
        """Its state without the digest of the plant, which takes as long to make as a short loop."""
        z = self.memory
        phi = float(z.phi_before[0])
        remembered: dict[str, Any] = {}
        if self.keeps_commands:
            held, sums = z.held[:, :, 0].tolist(), z.total[:, :, 0].tolist()
            remembered = {"commands": {"k": self._next, "held": held, "sums": sums}, "clock": self._clock.state()}
        if self._reads_commands:
            remembered["missed"] = int(z.missed[0])
        if self.observer:
            remembered["filter"] = z.filter[:, 0].tolist()
        if self.safety:
            remembered["plan"] = z.plan[:, 0].tolist()
        if self._watches:
            remembered["observer"] = [None if math.isnan(value) else value for value in z.observer[:, 0].tolist()]
        if self.plant.p_names:
            remembered["parameters"] = self._numbers
        rate = None if math.isnan(phi) else phi
        start = {"D_hat": self.D_hat, "phi": rate, "step": self._step, "t0": self._t0}
        return start | remembered

    @cached_property
    def _formulas(self) -> str:
        """A digest of the plant, numbers aside, by which a state of another one is refused."""
        return hashlib.sha256(json.dumps(dict(self.plant.formulas), sort_keys=True).encode()).hexdigest()[:16]

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a saved state; without phi as from a first step, without t0 from 0. Raises ConfigError if none."""
        try:
            D_hat, step = state["D_hat"], operator.index(state["step"])
            phi, t0 = state.get("phi"), state.get("t0", 0.0)
        except (AttributeError, KeyError, TypeError, ValueError):
            raise ConfigError(f"state: expected D_hat and step, got {state!r}; save it with state()") from None
        if "plant" in state and state["plant"] != self._formulas:
            raise ConfigError(f"state: expected one of plant {self.plant.name}, got another's; restore it there")
        before = self._remembered()
        self._recall(state)
        try:
            self._set_state(D_hat, phi, step, t0)
        except ConfigError:
            self._recall(before)
            raise
        self._awaits_X = self._awaits_X and step == 0

    def fresh(self) -> "Controller":
        """Another one with these parts, which starts from this one's D_hat and t without a past."""
        other = type(self)(self.loop)
        other.settings.p[:] = self.settings.p
        other._set_state(self.D_hat, None, 0, self.t)
        return other

    @property
    def loop(self) -> Loop:
        """The description that another controller with these parts and this D_hat is made of."""
        return self._loop.filled(D_hat=self.D_hat, history_length=self._longest)

    def __repr__(self) -> str:
        adapts = "frozen" if self.adaptation is None else f"by {type(self.adaptation).__name__}"
        dt, t, D_hat = map(self.plant.time_text, (self.dt, self.t, self.D_hat))
        times = f"dt = {dt}, t = {t}, D_hat = {D_hat} {adapts}"
        return f"<Controller of plant {self.plant.name} with {self.predictor!r}, {times}>"

    def __getstate__(self) -> dict[str, Any]:
        return {"loop": self.loop, "state": self.state(), "P": self._last_P}

    def __setstate__(self, saved: Mapping[str, Any]) -> None:
        Controller.__init__(self, saved["loop"])
        self.restore(saved["state"])
        self._last_P[:] = saved["P"]

    def _take_memory(self, size: int, D_hat: float) -> None:
        """The buffers of all steps: `size` numbers of an observer of the delay, commands back to the longest delay."""
        n, m, nx, longest = self.plant.n, self.plant.m, self.predictor.nx, self._loop.history_length
        largest = 0.0 if self.plant.declares_delay else D_hat
        needed = max(largest, float(self.settings.bounds[1]) if self.adaptation else 0.0)
        if longest is None:
            declared = self._reads_commands and self.plant.declares_delay
            longest = DELAYS * float(self.plant.delay(self.plant.target(0.0), 0.0)) if declared else needed
        elif longest < needed:
            what = f"expected at least the largest delay, {self.plant.time_text(needed)}"
            raise ConfigError(f"history_length: {what}, got {longest!r}; raise it")
        longest = float(longest)
        self._last_U = np.zeros(m)
        self._last_P = np.full((nx, n), np.nan)
        self._longest = longest
        self._kept_for = (int(longest / self.dt) + self._oldest + 0.5) * self.dt if self._oldest else longest
        held, total = history(self._kept_for, self._kept_for, self.dt, self._past(np.zeros(n)))[1:]
        self._clock, Y = Clock(n, m, len(self.outputs)), np.zeros((n, 1))
        arrays = {"Y": Y, "X_hat": np.zeros((n, 1)) if self._reads_commands else Y, "held": held, "total": total}
        arrays |= {"u": np.zeros((nx, m, 1)), "u_nodes": np.zeros((nx, m, 1)), "D_seen": np.zeros((m, 1))}
        arrays |= {"error": np.full(1, np.nan), "clock": self._clock.memory[:, None]}
        if self.observer:
            arrays |= {"filter": np.array(self.observer.start(), dtype=float)[:, None]}
        sizes = {"n": n, "m": m, "nx": nx, "observer": size, "past": 0, "outputs": len(self.outputs), "filter": 0}
        sizes |= self.safety.sizes(self.plant) if self.safety else {"ends": 0, "plan": 0}
        self._set_memory(signals.State(**signals.memory(signals.STATE, sizes, 1, arrays)))

    def _set_memory(self, memory: signals.State) -> None:
        self.memory = z = memory
        self._Y = (z.sample if self.observer else z.Y)[:, 0]  # the only lane
        self._u, self._u_nodes = z.u[:, :, 0], z.u_nodes[:, :, 0]
        self._P, self._U = z.P[:, :, 0], z.U[:, 0]
        self._engine = Engine(self.parts, self.settings, memory)

    def _past(self, X: np.ndarray) -> inputs.Past:
        """The commands before the first step, for the state (n,) that the law would have held."""
        span = np.array([self._first_D_hat])
        plant = self.plant
        if self.parameters != plant.parameters:  # kappa is that of what was set
            plant = plants.varied(plant, tuple(self.parameters.items()))
        limits = self.settings.input_bounds if self._by_law else self._loop.input_bounds
        return inputs.past(plant, self._loop.u0, limits, X[None], span)

    def _reset_clock(self, k: int | None = None, calls: int = 0) -> None:
        """Set the clock before the call of control step k, the first by default."""
        k = len(self.memory.held) - 1 if k is None else k
        X_hat = self.memory.filter[: self.plant.n, 0] if self.observer else None
        last = self.memory.held[(k - 1) % len(self.memory.held), :, 0]
        self._clock.start(k, last, self.plant.ratios * self.D_hat, X_hat, calls)

    @property
    def _numbers(self) -> dict[str, float]:
        """All that the plant's functions read as p, by name."""
        return dict(zip(self.plant.p_names, self.settings.p.tolist(), strict=True))

    @property
    def _next(self) -> int:
        """The control step of the next call, in the history."""
        return int(self._clock["at"] + ROUNDING) + 1

    def _times(self, t: Any, sampled_at: Any) -> tuple[float, float, float]:
        """The time of a call, the control steps since the last one, and the age of its sample in control steps.

        Raises ConfigError for a call that is not after the last one, and a sample later than it by more than dt.
        """
        now, gap, age = self.t, 1.0, 0.0
        if t is not None:
            now, last = array_checks.number("t", t), self.t - self.dt
            if not self._reads_commands:
                came = f"got {self.actuator!r}, whose calls are each dt"
                raise ConfigError(f't: expected actuator="history", {came}; omit t')
            starts, regular = not self._clock["calls"], abs(now - self.t) <= SNAP * self.dt
            if not math.isfinite(now) or not (starts or regular or now > last):
                after = "" if starts else f" after that of the last call, {last:.9g}"
                raise ConfigError(f"t: expected a finite time{after}, got {now:.9g}; use one clock")
            if not (starts or regular):
                gap = float(snapped((now - last) / self.dt))
        if sampled_at is not None:
            age = (now - array_checks.number("sampled_at", sampled_at)) / self.dt
            if not -1.0 <= age < math.inf:
                what = f"expected a time up to that of the call, {now:.9g}, got {sampled_at!r}"
                raise ConfigError(f"sampled_at: {what}; use one clock")
            if not self._reads_commands and age > SNAP:
                raise ConfigError(f'sampled_at: expected actuator="history", got {self.actuator!r}; omit it')
            age = max(float(snapped(age)), 0.0)
        return now, gap, age

    def _recall(self, state: Mapping[str, Any]) -> None:
        """Take the commands and the observer of a saved state, where it has them. Raises ConfigError for others."""
        z = self.memory
        commands = state.get("commands", {"k": self._next, "held": z.held[:, :, 0], "sums": z.total[:, :, 0]})
        missed, clock = state.get("missed", 0), state.get("clock")
        parameters = state.get("parameters", self._numbers)
        observer = [math.nan if value is None else value for value in state.get("observer", z.observer[:, 0])]
        try:
            k, held, sums = operator.index(commands["k"]), np.array(commands["held"]), np.array(commands["sums"])
            fits = held.shape == sums.shape and held.shape[1:] == (self.plant.m,) and len(observer) == len(z.observer)
            fits = fits and len(held) <= k + 1 <= 2 * len(held) and operator.index(missed) >= 0
            filtered = np.array(state.get("filter", z.filter[:, 0]), dtype=float)
            plan = np.array(state.get("plan", np.zeros(len(z.plan))), dtype=float)
            if parameters != (before := self._numbers):
                fits = fits and [*parameters] == [*before] and np.isfinite([*parameters.values()]).all()
                fits = fits and all(parameters[name] == before[name] for name in self.fixed)
            for one, memory in ((filtered, z.filter), (plan, z.plan)):
                fits = fits and one.shape == memory[:, 0].shape and np.isfinite(one).all()
            if clock is not None:
                Clock(self.plant.n, self.plant.m, len(self.outputs)).restore(clock)
        except (AttributeError, KeyError, TypeError, ValueError):
            fits = False
        if not fits:
            raise ConfigError("state: expected the commands of such a controller, got others; save it with state()")
        self.settings.p[:] = [*parameters.values()]
        z.observer[:, 0], z.filter[:, 0], z.plan[:, 0], z.missed[0] = observer, filtered, plan, missed
        held, sums = held[:, :, None].astype(float), sums[:, :, None].astype(float)  # maybe longer than those before
        self._set_memory(z._replace(held=np.ascontiguousarray(held), total=np.ascontiguousarray(sums)))
        if clock is None:  # saved without one, by a block of python-control say
            self._reset_clock(k, int(state["step"] > 0))
        else:
            self._clock.restore(clock)
        if self._watches and math.isnan(observer[-1]):  # observers of the delay start at a sample that is believed
            self._clock.now[:] = np.nan

    def _set_state(self, D_hat: Any, phi: Any, step: int, t0: Any) -> None:
        """Set the state of the next step, phi None for none. Raises ConfigError, and stays as it is, if wrong."""
        seconds, start = array_checks.number("D_hat", D_hat), array_checks.number("t", t0)
        rate = math.nan if phi is None else array_checks.number("phi", phi)
        low, high = self.settings.bounds
        array_checks.within("D_hat", np.array(seconds), (low, high), self.plant.time_unit)
        if self._reads_commands and seconds > self.longest_D_hat:
            what = f"expected at most {self.plant.time_text(self.longest_D_hat)}, as far as the history reaches"
            raise ConfigError(
                f"D_hat: {what}, got {self.plant.time_text(seconds)}; make another controller with that D_hat"
            )
        if not 0 <= step <= STEPS:
            came = "a negative one" if step < 0 else "a larger one"
            raise ConfigError(f"step: expected a whole number of 0 to 2^53, got {came}; save it with state()")
        if not math.isfinite(start + step * self.dt):
            raise ConfigError(f"t: expected a finite time, got {start:g} and {step} steps; give a finite one")
        if math.isinf(rate):
            raise ConfigError("phi: expected a finite number or none, got infinity; save it with state()")
        z = self.memory
        z.D_hat[0], z.phi_before[0], self._step, self._t0 = seconds, rate, step, start

    def _measure(self, X: np.ndarray, u: Any, u_nodes: Any) -> None:
        u = self._u if u is None else array_checks.nodes("u", u, self.plant.m)
        u_nodes = u if u_nodes is None else array_checks.nodes("u_nodes", u_nodes, self.plant.m)
        expected = self._Y.shape, self._u.shape
        for values in (u, u_nodes):
            if (X.shape, values.shape) != expected:  # broadcasting would hide a sensor that is lost
                came = f"{X.shape} and {values.shape}"
                raise ConfigError(f"step: expected X {expected[0]} and u {expected[1]}, got {came}; measure those")
        self._Y[:] = X
        if not self._reads_commands:
            self._u[:], self._u_nodes[:] = u, u_nodes

    def _refusal(self, code: int, came: bool, age: float, booked: bool) -> str:
        """Why a step, with a sample of that age if one came, gives no U to send, and the cure, in words."""
        time, longest = self.plant.time_text, self.memory.D_seen.max()
        sample = "none" if not came else "one that is not newer than the last"
        if came and age > self._oldest:
            sample = f"one that is {time(age * self.dt)} old, more than max_sample_age = {time(self._oldest * self.dt)}"
        reason = {
            engine.MEASUREMENT: f"expected finite {'X' if self._reads_commands else 'X and u'}, got one that is not",
            engine.PREDICTION: "the prediction from X and u is not finite",
            engine.TOO_LONG: f"expected a delay of at most {time(self.longest_D_hat)}, as far as the history reaches, "
            f"got {time(longest)}; raise history_length",
            engine.UNKNOWN: f"expected a sample of X, for nothing tells the state, got {sample}",
        }[code]
        sent = f": {source_lines.values(self.plant.inputs, self.memory.U[:, 0])} is assumed sent" if booked else ""
        return f"step: {reason}; {HELD}{sent}"

    def _warm_up(self) -> None:
        """Compile and load all that a step runs, so that the first step takes no longer than the others."""
        state = self._remembered()
        self._engine.call(self.t, 1.0, True, 0.0)
        self.restore(state)
        self.memory.innovation[:] = self.memory.error[:] = np.nan
        for signal in ("fallback", "kept", "filtered", "unkept"):
            getattr(self.memory, signal)[:] = 0.0

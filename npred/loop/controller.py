"""The controller alone, for a real plant: one control step per call, on memory taken at the start."""

import hashlib
import json
import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, Unpack

import numpy as np

from npred import plants
from npred.base import array_checks, source_lines
from npred.base.errors import ConfigError, DivergedError, unlisted
from npred.base.notebook import InNotebook
from npred.base.progress import say
from npred.estimation.delay_law import Adaptation, DelayLaw
from npred.loop import assembly, control_step, engine, status
from npred.loop.acts import HISTORY
from npred.loop.engine import Engine
from npred.loop.loop import ControllerParts, Loop
from npred.loop.memory import Memory
from npred.loop.status import Status
from npred.loop.timing import SNAP, snapped
from npred.plants import inputs, setpoint
from npred.plants.base import Plant
from npred.prediction.methods import Predictor

HELD = "keep the actuator at the last U and pass the next sample"


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
    `max_sample_age` ago (50 control steps by default): X_hat is the model's state from the last sample on.
    `observer`, one of npred.observers, estimates X from the plant's outputs, of which `step` then gets the samples; it
    accepts an output within 6 `outlier_limit` standard deviations (EKF), or `outlier_limit` half ranges (Luenberger),
    and restarts if it refused one for a time of D_hat. `watchdog` gives U if no sample comes (npred.Watchdog).
    `safety` keeps the limits that the plant declares (npred.SafetyFilter); with an uncertain delay it needs "history".

    Raises ConfigError for parts that do not fit together.
    """

    def __init__(self, loop: Loop) -> None:
        plant, predictor = loop.plant, loop.predictor
        if predictor is None:
            raise ConfigError("predictor: expected one, got None; make one with npred.predictor or npred.load")
        dt, gate = array_checks.number("dt", loop.dt), loop.outlier_limit
        law, D_hat = assembly.first_estimate(loop)
        limits = inputs.bounds(plant, loop.input_bounds)
        u0 = inputs.start(plant, loop.u0, limits)
        self._loop = loop = loop.filled(dt=dt, adaptation=law, D_hat=D_hat, input_bounds=limits, u0=u0)
        self.plant, self.predictor, self.adaptation, self.dt, self.actuator = plant, predictor, law, dt, loop.actuator
        self.outlier_limit, self.observer, self.watchdog, self.safety = gate, loop.observer, loop.watchdog, loop.safety
        self._reads_commands, self._by_law = loop.reads_commands, isinstance(u0, str) and u0 == inputs.LAW
        laws = assembly.law(loop)
        self.parts, self.settings = assembly.kernels(loop, laws), assembly.settings(loop, laws)
        if D_hat is not None:
            array_checks.within("D_hat", np.array(D_hat), tuple(laws.bounds), plant.time_unit)
        if D_hat is not None and not plant.declares_delay:
            longest = D_hat if law is None else law.bounds[1]
            if law is not None:
                control_step.check("dt", dt, longest)
            if text := control_step.doubt("dt", dt, longest, plant, law is not None):
                say(text)
        for text in loop.safety.doubts(plant, dt, self.settings.safety, limits) if loop.safety else ():
            say(text)
        self._last_U, self._last_P = np.zeros(plant.m), np.full((predictor.nx, plant.n), np.nan)
        self.memory = Memory(loop, laws, self.settings, self._past(np.zeros(plant.n)))
        self.keeps_commands = self.memory.keeps_commands
        self._awaits_X = False
        self._view()
        self._warm_up()
        self._awaits_X = self._by_law  # for the commands before the first step

    @property
    def D_hat(self) -> float:
        """The delay estimate of the next step. Set it within the adaptation's bounds, else ConfigError.

        D_hat goes on from there as from a first step, without phi of the last one.
        """
        return self.memory.D_hat

    @D_hat.setter
    def D_hat(self, seconds: float) -> None:
        self.memory.set(seconds, None, self.memory.step, self.memory.t0)

    @property
    def t(self) -> float:
        """The time of the next step, which a plant that depends on time reads: 0 at the start.

        Each step adds dt. Set it to go on from another time, finite, else ConfigError, as from a first step.
        """
        return self.memory.t

    @t.setter
    def t(self, seconds: float) -> None:
        self.memory.set(self.D_hat, None, 0, seconds)
        self.memory.clock.forget()
        self.memory.signals.missed[0] = 0.0

    @property
    def parameters(self) -> dict[str, float]:
        """The plant's parameters as the next step reads them, a copy; see `set`."""
        return dict(zip(self.plant.parameters, self.settings.p.tolist(), strict=False))

    @property
    def fixed(self) -> dict[str, str]:
        """Why a parameter cannot be set, by its name."""
        return self.memory.fixed

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
    def outputs(self) -> tuple[str, ...]:
        """The names of a sample's numbers: the states, or the outputs of its observer."""
        return assembly.outputs(self._loop)

    @property
    def X_hat(self) -> np.ndarray:
        """The state that the last step predicted from, (n,), a copy: the sample, or the model's state since."""
        return self.memory.signals.X_hat[:, 0].copy()

    @property
    def status(self) -> Status:
        """The events of the last step (npred.loop.status)."""
        return status.of(self.memory)

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
        now, gap, age = self.memory.t, 1.0, 0.0
        if t is not None or sampled_at is not None:
            now, gap, age = self._times(t, sampled_at)
        sent = None if applied is None else self._sent(applied)
        came = X is not None
        if came:
            self._measure(array_checks.floats("X", X), u, u_nodes)
        before = None
        if self._awaits_X:
            if not came or not np.isfinite(self._Y).all():
                got = "one that is not" if came else "none"
                raise DivergedError(f"step: expected a finite first X, for u0 is kappa of it, got {got}; {HELD}")
            before = self.memory.state()
            self.memory.begin(self._past(self._Y))
        if sent is not None:
            self._engine.replace(sent)
        code = self._engine.call(now, gap, came, age)
        if code and before is not None:  # nothing was sent, and the commands before the first X are not known
            self._recall(before)
            raise DivergedError(self._refusal(code, came, age, booked=False))
        if t is not None and abs(now - self.memory.t) > SNAP * self.dt:
            self.memory.t0, self.memory.step = now, 0
        self.memory.step += 1
        if code:
            raise DivergedError(self._refusal(code, came, age, booked=self.keeps_commands))
        self._awaits_X = False
        return self._last_U

    def state(self) -> dict[str, Any]:
        """Its state, ready for JSON: D_hat, phi of the last step, the steps done since t0, and, as it has
        them, commands, observers and parameters; and of which plant it is."""
        return {"plant": self._formulas} | self.memory.state()

    @cached_property
    def _formulas(self) -> str:
        """A digest of the plant, numbers aside, by which a state of another one is refused."""
        return hashlib.sha256(json.dumps(dict(self.plant.formulas), sort_keys=True).encode()).hexdigest()[:16]

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a saved state; without phi as from a first step, without t0 from 0. Raises ConfigError if none."""
        if isinstance(state, Mapping) and "plant" in state and state["plant"] != self._formulas:
            raise ConfigError(f"state: expected one of plant {self.plant.name}, got another's; restore it there")
        self._recall(state)

    def _recall(self, state: Mapping[str, Any]) -> None:
        try:
            self.memory.restore(state)
        finally:
            self._view()
        self._awaits_X = self._awaits_X and state["step"] == 0

    def fresh(self) -> "Controller":
        """Another one with these parts, which starts from this one's D_hat and t without a past."""
        other = type(self)(self.loop)
        other.settings.p[:] = self.settings.p
        other.memory.set(self.D_hat, None, 0, self.t)
        return other

    @property
    def loop(self) -> Loop:
        """The description that another controller with these parts and this D_hat is made of."""
        D_hat = self._loop.D_hat if self.plant.declares_delay else self.D_hat
        return self._loop.filled(D_hat=D_hat, history_length=self.memory.longest)

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

    def _view(self) -> None:
        """Look at the arrays of the memory, of the only lane."""
        z = self.memory.signals
        self._Y = (z.sample if self.observer else z.Y)[:, 0]
        self._u, self._u_nodes = z.u[:, :, 0], z.u_nodes[:, :, 0]
        self._engine = Engine(self.parts, self.settings, z, kept=(self._last_P, self._last_U))

    def _past(self, X: np.ndarray) -> inputs.Past:
        """The commands before the first step, for the state (n,) that the law would have held."""
        span = np.array([self._loop.D_hat or 0.0])
        plant = self.plant
        if self.parameters != plant.parameters:  # kappa is that of what was set
            plant = plants.varied(plant, tuple(self.parameters.items()))
        limits = self.settings.input_bounds if self._by_law else self._loop.input_bounds
        return inputs.past(plant, self._loop.u0, limits, X[None], span)

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
            starts, regular = not self.memory.clock["calls"], abs(now - self.t) <= SNAP * self.dt
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

    def _sent(self, applied: Any) -> np.ndarray:
        if not self.keeps_commands:
            what = "expected a controller that reads u from its commands, got one that is given u"
            raise ConfigError(f"applied: {what}; omit it")
        sent = array_checks.floats("applied", applied)
        if sent.shape != (self.plant.m,) or not np.isfinite(sent).all():
            what = f"expected {self.plant.m} finite numbers, one per input"
            raise ConfigError(f"applied: {what}, got {applied!r}; give U")
        return sent

    def _measure(self, X: np.ndarray, u: Any, u_nodes: Any) -> None:
        if u is None and u_nodes is None and X.shape == self._Y.shape:  # the usual case
            self._Y[:] = X
            return
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
        time, z, longest = self.plant.time_text, self.memory.signals, self.memory.longest_D_hat
        sample, oldest = "none" if not came else "one that is not newer than the last", self.memory.oldest * self.dt
        if came and age > self.memory.oldest:
            sample = f"one that is {time(age * self.dt)} old, more than max_sample_age = {time(oldest)}"
        reason = {
            engine.MEASUREMENT: f"expected finite {'X' if self._reads_commands else 'X and u'}, got one that is not",
            engine.PREDICTION: "the prediction from X and u is not finite",
            engine.TOO_LONG: f"expected a delay of at most {time(longest)}, as far as the history reaches, "
            f"got {time(z.D_seen.max())}; raise history_length",
            engine.UNKNOWN: f"expected a sample of X, for nothing tells the state, got {sample}",
        }[code]
        sent = f": {source_lines.values(self.plant.inputs, z.U[:, 0])} is assumed sent" if booked else ""
        return f"step: {reason}; {HELD}{sent}"

    def _warm_up(self) -> None:
        """Compile and load all that a step runs, so that the first step takes no longer than the others."""
        state = self.memory.state()
        self._engine.call(self.t, 1.0, True, 0.0)
        self._recall(state)
        self._last_P[:], self._last_U[:] = np.nan, 0.0
        z = self.memory.signals
        z.innovation[:] = z.error[:] = np.nan
        for signal in (z.fallback, z.kept, z.filtered, z.unkept, z.promised):
            signal[:] = 0.0

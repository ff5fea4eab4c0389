"""A robot from its MJCF file by MuJoCo, a physics engine that cannot be traced: a black box. Extra: npred[mujoco].

from pathlib import Path
from threading import Lock
from npred_robots import mujoco_chain

Arm = mujoco_chain(Path(__file__).with_name("my_arm.xml"))
"""

import math
import warnings
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from npred.base.errors import ConfigError, required, unlisted
from npred.formulas import Parameters, Value
from npred_robots.chain import GAINS, by_library, declaration, driven, wave_of
from npred_robots.rigid_body import pushes
from npred_robots.urdf import names_of

INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast")  # MuJoCo's names
LEFT_OUT = ("CONSTRAINT", "CLAMPCTRL", "SENSOR", "AUTORESET")  # flags of what is no smooth function of state and input
LEVEL = 1e-3  # sine of the angle under which a rail is level
SERVOS = {"position": ("target", ("m", "rad")), "velocity": ("speed", ("m/s", "rad/s"))}  # by what they feed back


def mujoco_chain(
    path: str | Path, pose: Sequence[float] | None = None, integrator: str | None = None, lock: Iterable[str] = (),
    actuated: Iterable[str] | None = None,
) -> type:  # fmt: skip
    """The declaration of the robot of an MJCF file, `traced = False`: npred_robots.chain.chain by MuJoCo's functions.

    (M(q) + armature) q'' + C(q, q') q' + G(q) + damping q' = U(t - D) + springs; states, inputs, law and reference are
    those of `chain`. q'' is mj_forward's, the law's torque mj_inverse's. `rollout` is the engine's own, for the
    predictor of that name: one step per interval of nodes. Gravity, a parameter, is the file's.

    Joints with an actuator have an input, all joints of a file without actuators; actuators that the file disables, by
    actuatorgroupdisable or all of them, are none. That of a motor is the torque or
    force of the joint, in the bounds of gear, ctrlrange, forcerange and actuatorfrcrange. That of a position or
    velocity servo is what it is sent, in the bounds of its ctrlrange: its feedback is part of the plant, and reacts
    without delay. Contacts, joint limits, dry friction and sensors are left out, with a warning for the first and the
    third.

    Parameters
    ----------
    path : str or Path
        An MJCF file of hinges and slides.
    pose : numbers, optional
        The middle of the wave, one number per joint.
    integrator : str, optional
        Of `rollout`: Euler, RK4, implicit or implicitfast; by default the file's.
    lock : names, optional
        Joints that do not move, but stand as the file draws them. Actuators, equalities and tendons of these alone are
        removed.
    actuated : names, optional
        The joints that get a motor, in place of all actuators of the file.

    Raises
    ------
    MissingError
        Without the extra.
    ConfigError
        For a file that MuJoCo refuses, for other joints, for equalities, tendons, flexible bodies and plugins, for
        actuators that have a state or are not at a joint, and for what only contacts hold against gravity.
    """
    engine = _Engine(Path(path), integrator, names_of(lock), None if actuated is None else names_of(actuated))
    wave = wave_of(engine.joints, pose)

    def rollout(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Value, p: Parameters) -> np.ndarray:
        with engine.alone:
            return engine.rollout(X, u, D_hat, p.gravity)

    functions = by_library(engine, engine.joints, wave) | {"rollout": rollout}
    gains = GAINS if "kappa" in functions else {}
    return declaration(
        Path(path).name, engine.joints, wave, functions, traced=False, files=(path,),
        parameters=gains | {"gravity": engine.gravity},
    )  # fmt: skip


class MujocoJoint(NamedTuple):
    """A joint of the file, as npred_robots.chain.declaration reads it."""

    joint: str
    slides: bool
    push: tuple[float, float]
    input: tuple[str, str]
    lower: float
    upper: float


class Drive(NamedTuple):
    """The torque of actuator number `actuator` on its joint: gain ctrl + bias + stiffness q + damping q', in which ctrl
    is `scale` times the input.
    """

    actuator: int
    scale: float
    gain: float
    bias: float
    stiffness: float
    damping: float


class _Engine:
    """MuJoCo's model of a file, row by row."""

    def __init__(
        self, path: Path, integrator: str | None, lock: Collection[str], actuated: Collection[str] | None
    ) -> None:
        self.mujoco = required("mujoco_chain", "mujoco", "mujoco", "mujoco")
        try:
            self.model = model = self._edited(path, lock, actuated).compile()
        except ConfigError:
            raise
        except ValueError as error:
            lines = str(error).strip().splitlines()[:2]  # the second names the element
            reason = ", ".join(lines).removeprefix("Error: ")
            cure = "lock all that it ties" if lock else "fix the file"
            raise ConfigError(f"{path}: expected an MJCF file, got: {reason}; {cure}") from None
        if integrator is not None:
            if integrator not in INTEGRATORS:
                raise ConfigError(unlisted("mujoco_chain: integrator", integrator, INTEGRATORS))
            model.opt.integrator = getattr(self.mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
        flags = self.mujoco.mjtDisableBit
        weightless = model.opt.disableflags & flags.mjDSBL_GRAVITY.value
        model.opt.disableflags &= ~(flags.mjDSBL_GRAVITY.value | flags.mjDSBL_ACTUATION.value)
        for part in LEFT_OUT:
            model.opt.disableflags |= getattr(flags, f"mjDSBL_{part}").value
        self.gravity = 0.0 if weightless else float(np.linalg.norm(model.opt.gravity))
        self.down = model.opt.gravity / self.gravity if self.gravity else np.array([0.0, 0.0, -1.0])
        self.data, self.alone = self.mujoco.MjData(model), Lock()
        try:
            self._check_joints()
            self._check_parts()
            self._read_joints()
            self._check_effects()
        except _NotTaken as error:
            raise ConfigError(f"{path}: {error}") from None
        self._warn(path)
        state = self.mujoco.mjtState
        self.held = state.mjSTATE_CTRL.value
        self.size = self.mujoco.mj_stateSize(model, state.mjSTATE_FULLPHYSICS.value)

    def _edited(self, path: Path, lock: Collection[str], actuated: Collection[str] | None) -> Any:
        """The file without its sensors, keys and disabled actuators, without the joints that are locked, and with
        motors where they are asked for, or at all joints where the file has no actuator.
        """
        spec = self.mujoco.MjSpec.from_file(str(path))
        for k, joint in enumerate(spec.joints):
            joint.name = joint.name or f"joint_{k}"
        names = [joint.name for joint in spec.joints]
        for option, chosen in (("lock", lock), ("actuated", actuated or ())):
            for name in chosen:
                if name not in names:
                    raise ConfigError(f"{path}: {unlisted(option, name, names, 'names of joints:')}")
        option = spec.option
        off = option.disableflags & self.mujoco.mjtDisableBit.mjDSBL_ACTUATION.value
        idle = [part for part in spec.actuators if off or _group(part.group) & option.disableactuator]
        for part in [*spec.sensors, *spec.keys, *(idle if actuated is None else spec.actuators)]:
            spec.delete(part)
        option.disableactuator = 0
        for part in self._tied(spec, lock) if lock else ():
            spec.delete(part)
        for joint in [joint for joint in spec.joints if joint.name in lock]:
            spec.delete(joint)
        if not len(spec.actuators) and (actuated is not None or not idle):
            for joint in spec.joints:
                if actuated is None or joint.name in actuated:
                    spec.add_actuator(trntype=self.mujoco.mjtTrn.mjTRN_JOINT, target=joint.name)
        return spec

    def _tied(self, spec: Any, lock: Collection[str]) -> list[Any]:
        """The equalities, tendons and actuators of these joints alone."""
        types, model = self.mujoco, spec.compile()
        tendons, equalities, actuators = list(spec.tendons), list(spec.equalities), list(spec.actuators)
        tied = []
        for k, part in enumerate(tendons):
            start = model.tendon_adr[k]
            row = slice(start, start + model.tendon_num[k])
            if all(kind == types.mjtWrap.mjWRAP_JOINT for kind in model.wrap_type[row]):
                tied += [part] if all(spec.joints[i].name in lock for i in model.wrap_objid[row]) else []
        names = {part.name for part in tied}
        for part in equalities:
            group = {types.mjtEq.mjEQ_JOINT: lock, types.mjtEq.mjEQ_TENDON: names}.get(part.type, ())
            tied += [part] if group and {part.name1, part.name2} <= {*group, ""} else []
        for part in actuators:
            group = lock if part.trntype in self._at_joints() else names
            if part.target in group and (group is lock or part.trntype == types.mjtTrn.mjTRN_TENDON):
                tied.append(part)
        return tied

    def _at_joints(self) -> tuple[Any, Any]:
        ways = self.mujoco.mjtTrn
        return ways.mjTRN_JOINT, ways.mjTRN_JOINTINPARENT

    def _name(self, kind: str, number: int) -> str:
        code = getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
        return self.mujoco.mj_id2name(self.model, code, number) or f"{kind}_{number}"

    def _check_joints(self) -> None:
        """Raise _NotTaken for a joint that is neither a hinge nor a slide, and for no joint."""
        kinds = self.mujoco.mjtJoint
        for k, kind in enumerate(map(kinds, self.model.jnt_type)):
            if kind not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
                name, got = self._name("joint", k), kind.name.removeprefix("mjJNT_").lower()
                cure = f"lock=({name!r},) if it is mounted; walking, driving or flying is not supported"
                raise _NotTaken(f"joint {name}: expected type hinge or slide, got {got}; {cure}")
        if not self.model.njnt:
            raise _NotTaken("expected a joint that moves, found none; fix the file")

    def _check_parts(self) -> None:
        """Raise _NotTaken for parts that tie joints together, or that are no rigid body."""
        model = self.model
        kinds, equalities = self.mujoco.mjtEq, np.flatnonzero(model.eq_active0)
        if len(equalities):
            first, kind = equalities[0], kinds(model.eq_type[equalities[0]])
            ties = [i for i in (model.eq_obj1id[first], model.eq_obj2id[first]) if i >= 0]
            joints = tuple(self._name("joint", i) for i in ties) if kind == kinds.mjEQ_JOINT else ()
            what = f"got the {kind.name.removeprefix('mjEQ_').lower()} equality {self._name('equality', first)}"
            cure = f"take it out, or lock={joints}" if joints else "take it out, or lock the joints that it ties"
            raise _NotTaken(f"expected a tree, {what}, which ties joints or bodies together; {cure}")
        for kind, count in (("tendon", model.ntendon), ("flex", model.nflex), ("plugin", model.nplugin)):
            if count:
                raise _NotTaken(f"expected rigid bodies and joints, got the {kind} {self._name(kind, 0)}; take it out")

    def _read_joints(self) -> None:
        """`joints`, and `drives` of those with a motor. Raises _NotTaken for one that is not taken."""
        model, slide = self.model, self.mujoco.mjtJoint.mjJNT_SLIDE.value
        names = [self._name("joint", k) for k in range(model.njnt)]
        actuators: dict[int, int] = {}
        for k in range(model.nu):
            joint = self._pulled_joint(k)
            if actuators.setdefault(joint, k) != k:
                raise _NotTaken(f"joint {names[joint]}: expected one actuator, got two; take one out")
        self.joints, self.drives = list[MujocoJoint](), list[Drive]()
        self.mujoco.mj_kinematics(model, self.data)
        for k, (name, kind) in enumerate(zip(names, model.jnt_type, strict=True)):
            slides = bool(kind == slide)
            push, ending = (0.0, 0.0), pushes(slides)
            if k in actuators:
                drive, push, ending = self._drive(actuators[k], k, slides)
                self.drives.append(drive)
            elif slides and not model.jnt_stiffness[k] and self.gravity and abs(self.data.xaxis[k] @ self.down) > LEVEL:
                what = "expected a motor or a spring for what slides along gravity, got neither"
                raise _NotTaken(f"joint {name}: {what}: contacts, which would hold it, are left out; lock or drive it")
            ends = model.jnt_range[k].tolist() if model.jnt_limited[k] else (-math.inf, math.inf)
            self.joints.append(MujocoJoint(name, slides, push, ending, *ends))
        if not self.drives:
            raise _NotTaken(f"expected a joint with a motor, got none; name them: actuated=({names[0]!r},)")

    def _check_effects(self) -> None:
        """Raise _NotTaken for an input that moves nothing, from its one end to its other."""
        low, high = np.array([joint.push for joint in self.joints if any(joint.push)]).T
        low = np.where(np.isfinite(low), low, np.where(np.isfinite(high), high - 2.0, -1.0))
        ends = np.stack([low, np.where(np.isfinite(high), high, low + 2.0)], axis=1)  # (m, 2)
        rows = np.repeat(ends.mean(axis=1)[None], 2 * len(ends), axis=0)
        for k, pair in enumerate(ends):
            rows[2 * k : 2 * k + 2, k] = pair
        still = np.zeros((len(rows), self.model.nv))
        moved = np.ptp(self.accelerations(still, still, rows, self.gravity).reshape(len(ends), 2, -1), axis=1)
        for drive, effect in zip(self.drives, moved.max(axis=1), strict=True):
            if not effect > 0:
                what = "expected an effect on its joint, got none"
                raise _NotTaken(f"actuator {self._name('actuator', drive.actuator)}: {what}; take it out")

    def _pulled_joint(self, k: int) -> int:
        """The joint of actuator k. Raises _NotTaken for one that is no motor and no servo of a joint."""
        model, types = self.model, self.mujoco
        cure = "take it out, or name the joints that get a motor instead: actuated=(…)"
        kinds = {
            "a joint's actuator": types.mjtTrn(model.actuator_trntype[k]) in self._at_joints(),
            "one without a state": types.mjtDyn(model.actuator_dyntype[k]) == types.mjtDyn.mjDYN_NONE,
            "a constant gain": types.mjtGain(model.actuator_gaintype[k]) == types.mjtGain.mjGAIN_FIXED,
            "an affine bias": types.mjtBias(model.actuator_biastype[k]).name in ("mjBIAS_NONE", "mjBIAS_AFFINE"),
            "a gain and a gear other than 0": model.actuator_gainprm[k, 0] and model.actuator_gear[k, 0],
            "one that adds no delay, damping or armature": not any(
                np.any(getattr(model, f"actuator_{part}", np.zeros(model.nu))[k])
                for part in ("delay", "damping", "armature")
            ),
        }
        for words, met in kinds.items():
            if not met:
                raise _NotTaken(f"actuator {self._name('actuator', k)}: expected {words}, got another; {cure}")
        return int(model.actuator_trnid[k, 0])

    def _drive(self, k: int, joint: int, slides: bool) -> tuple[Drive, tuple[float, float], tuple[str, str]]:
        """How actuator k drives its joint, the bounds of its input, and the ending and unit of the input's name."""
        model, free = self.model, np.array([-math.inf, math.inf])
        gear, gain = model.actuator_gear[k, 0], model.actuator_gainprm[k, 0]
        bias, stiffness, damping = (model.actuator_biastype[k] != 0) * model.actuator_biasprm[k, :3]
        sent = model.actuator_ctrlrange[k] if model.actuator_ctrllimited[k] else free
        drive = Drive(k, 1.0, gear * gain, gear * bias, gear**2 * stiffness, gear**2 * damping)
        if stiffness or damping:
            ending, units = SERVOS["position" if stiffness else "velocity"]
            return drive, (float(sent[0]), float(sent[1])), (ending, units[not slides])
        force = model.actuator_forcerange[k] if model.actuator_forcelimited[k] else free
        whole = model.jnt_actfrcrange[joint] if model.jnt_actfrclimited[joint] else free
        ranges = np.sort([gear * gain * sent, gear * (force - bias), whole - gear * bias])
        model.actuator_forcelimited[k] = model.jnt_actfrclimited[joint] = 0  # the input's bounds say it
        push = float(ranges[:, 0].max()), float(ranges[:, 1].min())
        if not push[0] < push[1]:
            ranges = "gear, ctrlrange, forcerange and actuatorfrcrange"
            raise _NotTaken(
                f"actuator {self._name('actuator', k)}: expected {ranges} with room, got {push}; widen them"
            )
        return drive._replace(scale=1.0 / drive.gain), push, pushes(slides)

    def _warn(self, path: Path) -> None:
        """Say what is left out that would move the robot otherwise."""
        model = self.model
        touching = int(np.count_nonzero(model.geom_contype | model.geom_conaffinity))
        parts = {f"contacts of {touching} geoms": touching > 1, "dry friction": model.dof_frictionloss.any()}
        if left := " and ".join(part for part, there in parts.items() if there):
            warnings.warn(f"{path}: {left} left out; npred simulates joints, motors and gravity", stacklevel=4)

    def accelerations(self, q: np.ndarray, rates: np.ndarray, u: np.ndarray, gravity: float) -> np.ndarray:
        """q'' (B, n) by mj_forward."""
        model, data, forward = self._pulled(gravity), self.data, self.mujoco.mj_forward
        accelerations = np.empty(q.shape)
        for at, rate, sent, row in zip(q, rates, self._sent(u), accelerations, strict=True):
            data.qpos, data.qvel, data.ctrl = at, rate, sent
            forward(model, data)
            row[:] = data.qacc
        return accelerations

    def torques(
        self, q: np.ndarray, rates: np.ndarray, accelerations: np.ndarray, speeds: np.ndarray, gravity: float
    ) -> np.ndarray:
        """The inputs (B, m) of that motion by mj_inverse, springs overcome, and damping as at `speeds`."""
        model, data, inverse = self._pulled(gravity), self.data, self.mujoco.mj_inverse
        torques = np.empty(q.shape)
        for at, rate, acceleration, row in zip(q, rates, accelerations, torques, strict=True):
            data.qpos, data.qvel, data.qacc = at, rate, acceleration
            inverse(model, data)
            row[:] = data.qfrc_inverse - model.jnt_actgravcomp * data.qfrc_gravcomp
        torques += model.dof_damping * (speeds - rates)
        _, scale, gain, bias, stiffness, damping = np.array(self.drives).T
        moved = driven(self.joints)
        back = bias + stiffness * q[:, moved] + damping * speeds[:, moved]
        return (torques[:, moved] - back) / (gain * scale)

    def _sent(self, u: np.ndarray) -> np.ndarray:
        """What the engine's actuators (…, m) are sent for the inputs (…, m), which are in the order of the joints."""
        sent = np.empty_like(u)
        for k, drive in enumerate(self.drives):
            sent[..., drive.actuator] = drive.scale * u[..., k]
        return sent

    def rollout(self, X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, gravity: float) -> np.ndarray:
        """P (B, nx, 2 n) of X (B, 2 n) by one call of mujoco.rollout for all rows of one D_hat (B,).

        The input of a step is the mean of u (B, nx, n) at its two nodes. NaN from where the engine gives up.
        """
        rows, nx, size = len(X), u.shape[1], X.shape[1]
        starts = np.zeros((rows, self.size))
        starts[:, 1 : 1 + size] = X  # after the time
        P = np.repeat(X[:, None], nx, axis=1)
        for D in np.unique(D_hat[D_hat > 0.0]):
            chosen = D_hat == D
            P[chosen, 1:] = self._rolled(starts[chosen], u[chosen], D / (nx - 1), gravity)[..., 1 : 1 + size]
        lost = np.maximum.accumulate((~(np.abs(P) < self.mujoco.mjMAXVAL)).any(axis=2), axis=1)
        P[lost] = np.nan
        return P

    def _rolled(self, starts: np.ndarray, u: np.ndarray, h: float, gravity: float) -> np.ndarray:
        """The engine's states (B, nx - 1, size) after each step of h."""
        from mujoco import rollout

        model = self._pulled(gravity)
        model.opt.timestep = h
        sent = self._sent(0.5 * (u[:, :-1] + u[:, 1:]))
        self.mujoco.set_mju_user_warning(lambda message: None)  # NaN says it; a file in the current folder need not
        try:
            return np.asarray(rollout.rollout(model, self.data, starts, sent, control_spec=self.held)[0])
        finally:
            self.mujoco.set_mju_user_warning(None)

    def _pulled(self, gravity: float) -> Any:
        self.model.opt.gravity = gravity * self.down
        return self.model


def _group(number: int) -> int:
    """The bit of a group of actuators; those beyond the 31st cannot be disabled."""
    return 1 << number if 0 <= number <= 30 else 0


class _NotTaken(ValueError):
    """What is not taken, without the file's name."""

"""An arm from its MJCF file by MuJoCo, a physics engine that cannot be traced: a black box. Extra: npred[mujoco].

from pathlib import Path
from threading import Lock
from npred_robots import mujoco_chain

Arm = mujoco_chain(Path(__file__).with_name("my_arm.xml"))
"""

import math
from collections.abc import Sequence
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from npred.base.errors import ConfigError, first_line, required, unlisted
from npred.formulas import Parameters, Value
from npred_robots.chain import by_library, declaration, wave_of

INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast")  # MuJoCo's names
LEFT_OUT = ("CONSTRAINT", "ACTUATION", "SENSOR", "AUTORESET")  # flags of what is no smooth function of state and input


def mujoco_chain(path: str | Path, pose: Sequence[float] | None = None, integrator: str | None = None) -> type:
    """The declaration of the arm of an MJCF file, `traced = False`: npred_robots.chain.chain by MuJoCo's functions.

    (M(q) + armature) q'' + C(q, q') q' + G(q) + damping q' = U(t - D) + springs; states, inputs, law and reference are
    those of `chain`. q'' is mj_forward's, the law's torque mj_inverse's. `rollout` is the engine's own, for the
    predictor of that name: one step per interval of nodes, by the file's integrator, or by `integrator` (Euler, RK4,
    implicit, implicitfast). Contacts, joint limits, dry friction, equality constraints, actuators and sensors of the
    file are left out. Inputs are bounded where every joint has an actuatorfrcrange.
    Raises MissingError without the extra, ConfigError for a file that MuJoCo refuses, and for joints that do not turn
    about or slide along one axis.
    """
    engine = _Engine(Path(path), integrator)
    wave = wave_of(engine.joints, pose)

    def rollout(X: np.ndarray, u: np.ndarray, D_hat: np.ndarray, t: Value, p: Parameters) -> np.ndarray:
        with engine.alone:
            return engine.rollout(X, u, D_hat, p.gravity)

    functions = by_library(engine, wave) | {"rollout": rollout}
    return declaration(Path(path).name, engine.joints, wave, functions, traced=False, files=(path,))


class MujocoJoint(NamedTuple):
    """A joint of the file, as npred_robots.chain.declaration reads it."""

    joint: str
    slides: bool
    effort: float


class _Engine:
    """MuJoCo's model of a file, row by row."""

    def __init__(self, path: Path, integrator: str | None) -> None:
        self.mujoco = required("mujoco_chain", "mujoco", "mujoco", "mujoco")
        try:
            self.model = model = self.mujoco.MjModel.from_xml_path(str(path))
        except ValueError as error:
            reason = first_line(error).removeprefix("Error: ")
            raise ConfigError(f"{path}: expected an MJCF file, got: {reason}; fix the file") from None
        flags = self.mujoco.mjtDisableBit
        for part in LEFT_OUT:
            model.opt.disableflags |= getattr(flags, f"mjDSBL_{part}").value
        if integrator is not None:
            if integrator not in INTEGRATORS:
                raise ConfigError(unlisted("mujoco_chain: integrator", integrator, INTEGRATORS))
            model.opt.integrator = getattr(self.mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
        kinds, self.joints = self.mujoco.mjtJoint, list[MujocoJoint]()
        hinge, slide = kinds.mjJNT_HINGE.value, kinds.mjJNT_SLIDE.value
        for k, (kind, limited) in enumerate(zip(model.jnt_type, model.jnt_actfrclimited, strict=True)):
            name = model.joint(k).name or f"joint_{k}"
            if kind not in (hinge, slide):
                raise ConfigError(f"{path}: joint {name}: expected type hinge or slide, got another; fix the file")
            effort = float(np.abs(model.jnt_actfrcrange[k]).min()) if limited else math.inf
            self.joints.append(MujocoJoint(name, bool(kind == slide), effort))
        if not self.joints:
            raise ConfigError(f"{path}: expected a joint that moves, found none; fix the file")
        self.data, self.alone = self.mujoco.MjData(model), Lock()
        state = self.mujoco.mjtState
        self.held = state.mjSTATE_QFRC_APPLIED.value
        self.size = self.mujoco.mj_stateSize(model, state.mjSTATE_FULLPHYSICS.value)

    def accelerations(self, q: np.ndarray, rates: np.ndarray, u: np.ndarray, gravity: float) -> np.ndarray:
        """q'' (B, n) by mj_forward."""
        model, data, forward = self._pulled(gravity), self.data, self.mujoco.mj_forward
        accelerations = np.empty(q.shape)
        for at, rate, force, row in zip(q, rates, u, accelerations, strict=True):
            data.qpos, data.qvel, data.qfrc_applied = at, rate, force
            forward(model, data)
            row[:] = data.qacc
        return accelerations

    def torques(
        self, q: np.ndarray, rates: np.ndarray, accelerations: np.ndarray, speeds: np.ndarray, gravity: float
    ) -> np.ndarray:
        """The torques (B, n) of that motion by mj_inverse, springs overcome, and damping as at `speeds`."""
        model, data, inverse = self._pulled(gravity), self.data, self.mujoco.mj_inverse
        torques = np.empty(q.shape)
        for at, rate, acceleration, row in zip(q, rates, accelerations, torques, strict=True):
            data.qpos, data.qvel, data.qacc = at, rate, acceleration
            inverse(model, data)
            row[:] = data.qfrc_inverse
        return torques + model.dof_damping * (speeds - rates)

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
        forces = 0.5 * (u[:, :-1] + u[:, 1:])
        self.mujoco.set_mju_user_warning(lambda message: None)  # NaN says it; a file in the current folder need not
        try:
            return np.asarray(rollout.rollout(model, self.data, starts, forces, control_spec=self.held)[0])
        finally:
            self.mujoco.set_mju_user_warning(None)

    def _pulled(self, gravity: float) -> Any:
        self.model.opt.gravity[2] = -gravity
        return self.model

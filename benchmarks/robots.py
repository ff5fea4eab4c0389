"""Robot files against the libraries that are made for them: URDF against Pinocchio, MJCF against MuJoCo.

python benchmarks/robots.py FOLDER

For each file the joints, the inputs, and the largest relative difference of mass matrix, bias, accelerations and input
bounds at 5 random states, or the line that refuses it. A tree that asks whether it is mounted is taken as if it were.
"""

import re
import warnings
from collections import Counter
from pathlib import Path

import harness
import mujoco
import numpy as np
import pinocchio

from npred.base.errors import ConfigError
from npred.base.registry import Source
from npred.formulas import array_math
from npred.plants.base import Plant
from npred.plants.black_box import BlackBox
from npred_robots import mujoco_chain, rigid_body, urdf
from npred_robots.chain import chain

RIGHT = 1e-6  # the largest relative difference


def apart(ours: np.ndarray, theirs: np.ndarray) -> float:
    """The largest difference relative to the largest number; infinite bounds must be alike."""
    both = np.isfinite(theirs)
    if not np.array_equal(ours[~both], theirs[~both]) or not np.isfinite(ours[both]).all():
        return np.inf
    return float(np.abs(ours[both] - theirs[both]).max(initial=0.0) / max(np.abs(theirs[both]).max(initial=0.0), 1e-9))


def by_pinocchio(path: Path, mounted: bool = False) -> tuple[Plant, float]:
    """The plant of a URDF file, and its largest difference."""
    plant, bodies = Plant("robot", chain(path, mounted=mounted)), urdf.read(path, mounted=mounted)
    try:
        pinocchio_model = pinocchio.buildModelFromUrdf(str(path))
    except ValueError:
        return plant, np.nan  # it misses a part that npred does not need
    data, zero = pinocchio_model.createData(), pinocchio.neutral(pinocchio_model)
    G, shift = np.zeros((pinocchio_model.nv, plant.n // 2)), np.zeros(pinocchio_model.nv)
    effort = []
    for body, (k, ratio, offset) in zip(bodies, rigid_body.moves(bodies), strict=True):
        i = pinocchio_model.joints[pinocchio_model.getJointId(body.joint)].idx_v
        G[i, k], shift[i] = ratio, offset
        if body.mimic is None and body.effort:
            limit = pinocchio_model.effortLimit[i]
            effort.append((k, limit if 0 < limit < 1e300 else np.inf))
    motors = [k for k, _ in effort]
    worst = [apart(np.array(plant.input_bounds or [(-np.inf, np.inf)] * plant.m)[:, 1], np.array(effort)[:, 1])]
    random = np.random.default_rng(0)
    for _ in range(5):
        y, v = random.uniform(-1, 1, (2, plant.n // 2))
        u = random.uniform(-1, 1, plant.m)
        q = pinocchio.integrate(pinocchio_model, zero, G @ y + shift)
        M = np.triu(pinocchio.crba(pinocchio_model, data, q))
        M = G.T @ (M + np.triu(M, 1).T) @ G
        damped = G.T @ (pinocchio_model.damping * (G @ v))
        bias = G.T @ pinocchio.nonLinearEffects(pinocchio_model, data, q, G @ v) + damped
        ours, force, rubs = plant.call("mechanics", [*y, *v], [*u], 0.0, [*plant.parameters.values()], array_math.NUMPY)
        force = np.array(force) - np.array(rubs) * v
        pushed = np.zeros(plant.n // 2)
        pushed[motors] = u
        worst += [apart(np.array(ours), M), apart(pushed - force, bias)]
        worst.append(apart(M @ plant.f(np.hstack([y, v]), u)[plant.n // 2 :], pushed - bias))
    return plant, max(worst)


def by_mujoco(path: Path) -> tuple[Plant, float]:
    """The plant of an MJCF file, and its largest difference."""
    plant = BlackBox("robot", mujoco_chain(path), source=Source(str(path), "robot", ""))
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT.value
    data, random, worst = mujoco.MjData(model), np.random.default_rng(0), []
    n, joints = plant.n // 2, model.actuator_trnid[:, 0] if model.nu else np.arange(model.nv)
    order = np.argsort(joints)
    servo = (model.actuator_biasprm[:, 1:3] != 0).any(axis=1) & (model.actuator_biastype != 0)

    def inputs() -> np.ndarray:
        """Those of npred: the joint's force, of a servo what it is sent."""
        if not model.nu:
            return data.qfrc_applied.copy()
        return np.where(servo, data.ctrl, data.qfrc_actuator[joints])[order]

    for _ in range(5):
        data.qpos, data.qvel = random.uniform(-1, 1, (2, n))
        if model.nu:
            limits = np.where(model.actuator_ctrllimited[:, None], model.actuator_ctrlrange, (-1.0, 1.0))
            data.ctrl = random.uniform(*limits.T)
        else:
            data.qfrc_applied = random.uniform(-1, 1, n)
        mujoco.mj_forward(model, data)
        worst.append(apart(plant.f(np.hstack([data.qpos, data.qvel]), inputs())[n:], data.qacc))
    if model.nu and plant.input_bounds:
        ends = []
        for side in (0, 1):
            data.qvel = 0.0
            data.ctrl = np.where(model.actuator_ctrllimited, model.actuator_ctrlrange[:, side], (-1e9, 1e9)[side])
            mujoco.mj_forward(model, data)
            ends.append(inputs())
        bounds = np.clip(np.array(plant.input_bounds), -1e9, 1e9)
        free = ~model.actuator_ctrllimited.astype(bool)[order] & (np.abs(ends) > 1e7).any(axis=0)
        worst.append(apart(bounds[~free], np.sort(np.array(ends).T, axis=1)[~free]))
    return plant, max(worst)


def row(path: Path) -> tuple[str, str]:
    """What became of a file, and the words on it."""
    try:
        try:
            plant, worst = by_mujoco(path) if path.suffix == ".xml" else by_pinocchio(path)
            mounted = ""
        except ConfigError as refusal:
            if "mounted=True" not in str(refusal):
                raise
            plant, worst = by_pinocchio(path, mounted=True)
            mounted = ", if mounted"
    except ConfigError as error:
        return "refused" if "\n" not in str(error) else "refused in several lines", str(error).split(": ", 1)[1]
    except Exception as error:
        return "failed", f"{type(error).__name__}: {error}"
    outcome = "taken, not by Pinocchio" if np.isnan(worst) else f"taken{mounted}" if worst <= RIGHT else "wrong"
    return outcome, f"{plant.n // 2} joints, {plant.m} inputs, {worst:.0e}"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    folder, totals = harness.options(__doc__, {"folder": Path}).folder, Counter[str]()
    paths = [path for path in folder.rglob("*") if path.suffix in (".urdf", ".xml") and path.is_file()]
    texts = {path.read_bytes(): path for path in sorted(paths, reverse=True)}
    for text, path in sorted(texts.items(), key=lambda item: item[1]):
        if path.suffix == ".urdf" or re.search(rb"<mujoco[\s>]", text):
            outcome, words = row(path)
            totals[outcome] += 1
            print(f"{path.relative_to(folder)!s:60}  {outcome}: {words}", flush=True)
    print(", ".join(f"{outcome} {count}" for outcome, count in totals.most_common()), f"of {totals.total()} files")

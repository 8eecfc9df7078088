"""MJCF in, Pinocchio model out: MuJoCo compiles the file, the numbers are taken from its model."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.robots.findings import suggest
from osc_contact.robots.limits import JointLimits
from osc_contact.robots.model import check_mass_matrix
from osc_contact.spatial import Array

__all__ = ["compile_mjcf", "couplings", "is_mjcf", "load_mjcf", "motors_of", "place", "trees_of"]

_NONE = 1e30  #: a limit that is none (N m, N, rad/s, m/s)


def is_mjcf(path: Path | str) -> bool:
    """Whether a file begins as MJCF does, with <mujoco>."""
    try:
        with Path(path).open("rb") as stream:
            head = stream.read(1 << 16)
    except OSError:
        return False
    tags = (part.split(None, 1) for part in head.split(b"<")[1:])
    first = (tag[0] for tag in tags if tag and tag[0][:1] not in (b"?", b"!"))
    return next(first, b"").rstrip(b"/>").startswith(b"mujoco")


def compile_mjcf(mjcf: Path | str | Any) -> Any:
    """The `MjModel` of a file, of a `MjSpec`, or itself.

    Raises:
        ModelError: MuJoCo is missing, or refuses the file.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ModelError(
            "MJCF is read by the package 'mujoco': pip install osc_contact[sim]"
        ) from error
    if isinstance(mjcf, mujoco.MjModel):
        return mjcf
    try:
        if isinstance(mjcf, mujoco.MjSpec):
            return mjcf.compile()
        if not Path(mjcf).is_file():
            raise ModelError(f"{mjcf}: there is no such file")
        return mujoco.MjModel.from_xml_path(str(mjcf))
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"{mjcf}: MuJoCo refuses it: {error}") from error


def load_mjcf(
    mjcf: Path | str | Any,
    tip: str | None = None,
    *,
    limits: Mapping[str, JointLimits] | None = None,
) -> pin.Model:
    """The Pinocchio model of an MJCF file, or of a `MjModel`.

    Joints stand where MuJoCo's qpos says, whatever their `ref`; armature, damping and frictionloss
    are those of its joints. Effort limits are the least of what actuators and joints name; a joint
    for which neither names one has none. Bodies and sites are frames.

    Args:
        mjcf: path, `MjSpec` or `MjModel`.
        tip: a body or site; only the bodies of its kinematic tree are read. None: all trees that
            do not begin with a free joint.
        limits: given by hand, by joint name or pattern, instead of the file's.

    Raises:
        ModelError: MuJoCo refuses the file, or the robot has what the toolkit does not know: free
            or ball joints, springs, weights that MuJoCo compensates.
        InvalidInputError: limits for joints that do not exist.
    """
    mj = compile_mjcf(mjcf)
    reader = _Reader(mj)
    reader.read(trees_of(mj, tip))
    _give_limits(reader.model, limits or {})
    check_mass_matrix(reader.model)
    return reader.model


def motors_of(mj: Any, joint: int) -> list[int]:
    """Numbers of the actuators that act on a joint directly."""
    direct = (0, 1)  # mjTRN_JOINT, mjTRN_JOINTINPARENT
    return [
        a for a in range(mj.nu)
        if int(mj.actuator_trntype[a]) in direct and int(mj.actuator_trnid[a, 0]) == joint
    ]  # fmt: skip


def couplings(mj: Any) -> dict[str, str]:
    """Joint → the joint that it follows by an <equality> of the file, "" where it is held."""
    found = {}
    for e in range(mj.neq):
        if int(mj.eq_type[e]) != 2 or not mj.eq_active0[e]:  # mjEQ_JOINT
            continue
        first, second = int(mj.eq_obj1id[e]), int(mj.eq_obj2id[e])
        name = mj.joint(first).name or f"joint{first}"
        found[name] = "" if second < 0 else mj.joint(second).name or f"joint{second}"
    return found


def trees_of(mj: Any, tip: str | None) -> set[int]:
    """First bodies of the trees to read."""
    if tip is None:
        tops = {int(mj.body_rootid[b]) for b in range(1, mj.nbody)}
        free = {int(mj.body_rootid[mj.jnt_bodyid[j]]) for j in range(mj.njnt)
                if int(mj.jnt_type[j]) == 0}  # fmt: skip
        if tops and not tops - free:
            raise ModelError("every body hangs on a free joint, which is not supported; fix a base")
        return tops - free
    names = {mj.body(b).name: b for b in range(mj.nbody)}
    sites = {mj.site(s).name: int(mj.site_bodyid[s]) for s in range(mj.nsite)}
    if tip not in names and tip not in sites:
        known = [name for name in (*names, *sites) if name]
        raise ModelError(f"the MuJoCo model has no body or site {tip!r}. {suggest(tip, known)}")
    body = names.get(tip, sites.get(tip, 0))
    if body == 0:
        raise ModelError(f"no joint moves {tip!r}: it is fixed to the world")
    return {int(mj.body_rootid[body])}


def _give_limits(model: pin.Model, limits: Mapping[str, JointLimits]) -> None:
    names, given = list(model.names)[1:], set()
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    for j, name in enumerate(names):
        key = next((key for key in limits if name == key or fnmatchcase(name, key)), None)
        if key is None:
            continue
        given.add(key)
        one = limits[key]
        low[j] = low[j] if one.lower is None else one.lower
        high[j] = high[j] if one.upper is None else one.upper
        if one.effort is not None:
            model.upperEffortLimit[j], model.lowerEffortLimit[j] = one.effort, -one.effort
        if one.velocity is not None:
            model.upperVelocityLimit[j], model.lowerVelocityLimit[j] = one.velocity, -one.velocity
    model.lowerPositionLimit, model.upperPositionLimit = low, high
    for key in limits:
        if key not in given:
            raise InvalidInputError(f"limits for {key!r}: no such joint; there are {names}")


class _Reader:
    """Bodies one by one into a Pinocchio model."""

    def __init__(self, mj: Any) -> None:
        self.mj, self.model = mj, pin.Model()
        self.model.name = "mjcf"
        self.model.gravity.linear = np.array(mj.opt.gravity)
        self._joint = {0: 0}  # of each body: number of the joint it moves with
        self._inside = {0: pin.SE3.Identity()}  # and where it is in that joint's frame
        self._above = {0: 0}  # the joint frame that carries it

    def read(self, roots: set[int]) -> None:
        """Bodies of the trees, sites behind them, then what MuJoCo says of the joints."""
        mj = self.mj
        bodies = [b for b in range(1, mj.nbody) if int(mj.body_rootid[b]) in roots]
        for b in bodies:
            self._body(b)
        for s in range(mj.nsite):
            b = int(mj.site_bodyid[s])
            if b in self._joint and mj.site(s).name:
                X = self._inside[b] * place(mj.site_pos[s], mj.site_quat[s])
                # beside its body, behind the same joint: a force sensor cuts before its body
                self._frame(mj.site(s).name, b, X, pin.FrameType.OP_FRAME, pin.Inertia.Zero())

    def _body(self, b: int) -> None:
        mj, model = self.mj, self.model
        parent, name = int(mj.body_parentid[b]), mj.body(b).name or f"body{b}"
        if mj.body_gravcomp[b] != 0.0:
            raise ModelError(
                f"body {name!r} has gravcomp {mj.body_gravcomp[b]:g}: MuJoCo carries its weight, "
                "and so would the control law; set gravcomp to 0"
            )
        joint, above = self._joint[parent], self._above[parent]
        X = self._inside[parent] * place(mj.body_pos[b], mj.body_quat[b])
        first = int(mj.body_jntadr[b])
        inertia = _inertia(mj, b)
        for j in range(first, first + int(mj.body_jntnum[b])):
            joint, X = self._moving(j, joint, X, above)
            above = model.getFrameId(model.names[joint], pin.FrameType.JOINT)
        self._joint[b], self._inside[b] = joint, X
        if mj.body_jntnum[b]:
            self._above[b] = above
            model.appendBodyToJoint(joint, inertia, X)
            self._frame(name, b, X, pin.FrameType.BODY, pin.Inertia.Zero())
            return
        weld = pin.Frame(f"{name}_weld", joint, above, X, pin.FrameType.FIXED_JOINT, inertia)
        self._above[b] = model.addFrame(weld)
        self._frame(name, b, X, pin.FrameType.BODY, pin.Inertia.Zero())

    def _frame(self, name: str, b: int, X: pin.SE3, kind: Any, inertia: pin.Inertia) -> None:
        frame = pin.Frame(name, self._joint[b], self._above[b], X, kind, inertia)
        self.model.addFrame(frame)

    def _moving(self, j: int, parent: int, X: pin.SE3, above: int) -> tuple[int, pin.SE3]:
        """A joint behind `parent` and the frame `above`, X where its body stands in `parent`.

        Returns its number, and the body in it.
        """
        mj, model = self.mj, self.model
        name = mj.joint(j).name or f"joint{j}"
        kind, dof, q = int(mj.jnt_type[j]), int(mj.jnt_dofadr[j]), int(mj.jnt_qposadr[j])
        if kind not in (2, 3):
            raise ModelError(
                f"joint {name!r} is a {('free', 'ball')[kind]} joint (nq ≠ nv), which is not "
                "supported; build it from hinges and slides, or fix it"
            )
        if mj.jnt_stiffness[j] != 0.0:
            raise ModelError(
                f"joint {name!r} has a spring of {mj.jnt_stiffness[j]:g}, which the control law "
                "does not know; set its stiffness to 0"
            )
        axis, at = np.array(mj.jnt_axis[j]), np.array(mj.jnt_pos[j])
        ref = float(mj.qpos0[q])
        make = pin.JointModelPrismaticUnaligned if kind == 2 else pin.JointModelRevoluteUnaligned
        back = pin.SE3(np.eye(3), -ref * axis) if kind == 2 else pin.SE3(
            pin.exp3(-ref * axis), np.zeros(3)
        )  # fmt: skip
        anchor = pin.SE3(np.eye(3), at)
        number = model.addJoint(parent, make(axis), X * anchor * back, name)
        model.addJointFrame(number, above)
        v = model.joints[number].idx_v
        model.armature[v], model.damping[v] = mj.dof_armature[dof], mj.dof_damping[dof]
        dry = float(mj.dof_frictionloss[dof])
        model.upperDryFrictionLimit[v], model.lowerDryFrictionLimit[v] = dry, -dry
        limited = bool(mj.jnt_limited[j])
        model.lowerPositionLimit[v] = mj.jnt_range[j, 0] if limited else -np.inf
        model.upperPositionLimit[v] = mj.jnt_range[j, 1] if limited else np.inf
        effort = _effort(mj, j)
        model.upperEffortLimit[v], model.lowerEffortLimit[v] = effort, -effort
        model.upperVelocityLimit[v], model.lowerVelocityLimit[v] = _NONE, -_NONE
        return number, anchor.inverse()


def _effort(mj: Any, joint: int) -> float:
    """Largest torque (N m, N): what joint and actuators permit; without a limit a huge number."""
    limits = [_NONE]
    if mj.jnt_actfrclimited[joint]:
        limits.append(float(np.abs(mj.jnt_actfrcrange[joint]).min()))
    strong = 0.0
    for a in motors_of(mj, joint):
        gear, most = abs(float(mj.actuator_gear[a, 0])), [_NONE]
        if mj.actuator_forcelimited[a]:
            most.append(float(np.abs(mj.actuator_forcerange[a]).min()))
        if mj.actuator_ctrllimited[a] and int(mj.actuator_biastype[a]) == 0:
            gain = abs(float(mj.actuator_gainprm[a, 0]))
            most.append(gain * float(np.abs(mj.actuator_ctrlrange[a]).min()))
        strong += gear * min(most) if min(most) < _NONE else _NONE
    return min(*limits, strong) if strong > 0.0 else min(limits)


def _inertia(mj: Any, b: int) -> pin.Inertia:
    R = pin.Quaternion(*mj.body_iquat[b]).toRotationMatrix()
    about_centre: Array = R @ np.diag(mj.body_inertia[b]) @ R.T
    return pin.Inertia(float(mj.body_mass[b]), np.array(mj.body_ipos[b]), about_centre)


def place(position: Array, quaternion: Array) -> pin.SE3:
    """From MuJoCo's w, x, y, z."""
    return pin.SE3(pin.Quaternion(*quaternion).toRotationMatrix(), np.array(position))

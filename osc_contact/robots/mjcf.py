"""Loading of MJCF files as Pinocchio models, with the numbers of the model that MuJoCo compiles."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeAlias
from xml.etree.ElementTree import ParseError, iterparse

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.errors import ModelError, did_you_mean, missing
from osc_contact.robots.checks import JointLimits, matching_limits
from osc_contact.robots.elements import MAX_BYTES, read_bytes
from osc_contact.robots.model import check_mass_matrix, joint_names
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from mujoco import MjModel, MjsBody, MjSpec

    MjcfSource: TypeAlias = Path | str | MjSpec | MjModel

_UNLIMITED = 1e30  #: limit of a joint without one (N m, N, rad/s, m/s)
#: MuJoCo's numbers of joint types
_FREE = 0
_BALL = 1
_SLIDE = 2


def is_mjcf(path: Path | str) -> bool:
    """True if a file is MJCF: its root element is <mujoco>, and its suffix is not .urdf.

    MuJoCo opens meshes and includes of an MJCF file in any folder, which a URDF must not make it
    do. Files larger than `MAX_BYTES` are not opened.

    Args:
        path: path of the file, which need not exist.
    """
    file = Path(path)
    try:
        if file.suffix.lower() == ".urdf" or file.stat().st_size > MAX_BYTES:
            return False
        with file.open("rb") as stream:
            return next(iterparse(stream, ["start"]))[1].tag == "mujoco"
    except (OSError, ValueError, LookupError, ParseError, StopIteration):
        return False


def compile_mjcf(mjcf: MjcfSource) -> MjModel:
    """Compile an MJCF file or a `MjSpec`; a `MjModel` is returned unchanged.

    Args:
        mjcf: path of the file, `MjSpec` or `MjModel`.

    Raises:
        ModelError: MuJoCo is not installed or refuses the file; or the file is not an MJCF file, or
            larger than 8 MiB.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ModelError(missing(error)) from error
    if isinstance(mjcf, mujoco.MjModel):
        return mjcf
    try:
        if isinstance(mjcf, mujoco.MjSpec):
            return mjcf.compile()
        read_bytes(Path(mjcf))  # refuses a folder, and a file that is too large
        if not is_mjcf(mjcf):
            raise ModelError(
                f"{mjcf} is no MJCF file: these begin with <mujoco> and are not called .urdf. "
                "Arm.from_urdf reads URDFs"
            )
        return mujoco.MjModel.from_xml_path(str(mjcf))
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"{mjcf}: MuJoCo refuses it: {error}") from error


# Values of a compiled model ----------------------------------------------------------------------


def joint_name(mj: MjModel, joint: int) -> str:
    """Name of a joint; "jointN" for a joint without a name.

    Args:
        mj: compiled model.
        joint: number N of the joint in the model.
    """
    return mj.joint(joint).name or f"joint{joint}"


def body_name(mj: MjModel, body: int) -> str:
    """Name of a body; "bodyN" for a body without a name.

    Args:
        mj: compiled model.
        body: number N of the body in the model.
    """
    return mj.body(body).name or f"body{body}"


def joints_of(mj: MjModel, body: int) -> range:
    """Numbers of the joints between a body and its parent.

    Args:
        mj: compiled model.
        body: number of the body in the model.
    """
    first = mj.body_jntadr[body]
    return range(first, first + mj.body_jntnum[body])


def motors_of(mj: MjModel, joint: int) -> list[int]:
    """Numbers of the actuators that act on a joint directly, not by a tendon or at a site.

    Args:
        mj: compiled model.
        joint: number of the joint in the model.
    """
    direct = np.isin(mj.actuator_trntype, (0, 1))  # mjTRN_JOINT, mjTRN_JOINTINPARENT
    return list(np.flatnonzero(direct & (mj.actuator_trnid[:, 0] == joint)))


def couplings(mj: MjModel) -> dict[str, str]:
    """Find the joints whose positions an <equality> of the file prescribes.

    Args:
        mj: compiled model.

    Returns:
        By the name of each such joint the name of the joint whose position determines its own; ""
        if the equality keeps it at a constant position.
    """
    from mujoco import mjtEq  # installed, as the model has been compiled

    masters = {}
    is_joint_equality = mj.eq_type == mjtEq.mjEQ_JOINT
    for e in np.flatnonzero(is_joint_equality & (mj.eq_active0 != 0)):
        master = mj.eq_obj2id[e]
        masters[joint_name(mj, mj.eq_obj1id[e])] = "" if master < 0 else joint_name(mj, master)
    return masters


def bodies_of(mj: MjModel, tip: str | None) -> list[int]:
    """Numbers of the bodies of a kinematic tree.

    Args:
        mj: compiled model.
        tip: a body or site of the tree; None: all trees that do not begin with a free joint.

    Raises:
        ModelError: there is no such body or site, or no joint moves it.
    """
    root = mj.body_rootid
    if tip is None:
        loose = np.isin(root, root[mj.jnt_bodyid[mj.jnt_type == _FREE]])
        if mj.nbody > 1 and loose[1:].all():
            raise ModelError("every body hangs on a free joint, which is not supported; fix a base")
        return list(np.flatnonzero(~loose)[1:])
    sites = {mj.site(s).name: mj.site_bodyid[s] for s in range(mj.nsite)}
    places = sites | {mj.body(b).name: b for b in range(mj.nbody)}
    if tip not in places:
        names = filter(None, places)
        raise ModelError(
            f"the MuJoCo model has no body or site {tip!r}; {did_you_mean(tip, names)}"
        )
    if places[tip] == 0:
        raise ModelError(f"no joint moves {tip!r}: it is fixed to the world")
    return list(np.flatnonzero(root == root[places[tip]]))


def pose(position: Array, quaternion: Array) -> pin.SE3:
    """Make a pose.

    Args:
        position: (3,) translation (m).
        quaternion: (4,) w, x, y, z.
    """
    return pin.SE3(pin.Quaternion(*quaternion), np.array(position))


def placed(X: pin.SE3) -> dict[str, Array]:
    """Keyword arguments `pos` and `quat` of MuJoCo's bodies, frames and sites, for a pose."""
    xyzw = pin.Quaternion(X.rotation).coeffs()
    return {"pos": X.translation, "quat": np.roll(xyzw, 1)}


def _joint_displacement(kind: int, place: Array, displacement: Array) -> pin.SE3:
    """Displacement of a body by its joint, as a pose in the frame of the body.

    Args:
        kind: MuJoCo's number of the joint's type, hinge or slide.
        place: (3,) position of the joint in the body (m).
        displacement: (3,) axis of the joint times its displacement (m, rad).
    """
    if kind == _SLIDE:
        return pin.SE3(np.eye(3), displacement)
    R = pin.exp3(displacement)
    return pin.SE3(R, place - R @ place)


# The Pinocchio model ------------------------------------------------------------------------------


def load_mjcf(
    mjcf: MjcfSource,
    tip: str | None = None,
    *,
    limits: Mapping[str, JointLimits] | None = None,
) -> pin.Model:
    """Build the Pinocchio model of an MJCF file.

    Joint positions are MuJoCo's qpos, with `ref` included; armature, damping and frictionloss are
    those of its joints. The effort limit of a joint is the lowest one of its actuators and of the
    joint itself; a joint without any has none. Bodies and sites become frames.

    Args:
        mjcf: path, `MjSpec` or `MjModel`.
        tip: a body or site; only the bodies of its kinematic tree are read. None: all trees that
            do not begin with a free joint.
        limits: limits by hand, by joint name or pattern, instead of the file's.

    Raises:
        ModelError: MuJoCo refuses the file, or the robot has free or ball joints, springs, or
            weights that MuJoCo compensates, which the toolkit does not support.
        InvalidInputError: limits for joints that do not exist.
    """
    mj = compile_mjcf(mjcf)
    model = pin.Model()
    model.name = "mjcf"
    model.gravity.linear = np.array(mj.opt.gravity)
    places = {0: _Place(0, pin.SE3.Identity(), 0)}
    for b in bodies_of(mj, tip):
        places[b] = _add_body(mj, model, b, places[mj.body_parentid[b]])
    for s in range(mj.nsite):
        site = mj.site(s)
        place = places.get(site.bodyid[0])
        if place is not None and site.name:
            X = place.X * pose(site.pos, site.quat)
            # a sibling of its body's frame: a wrist sensor at a site measures the body's load, too
            _add_frame(model, site.name, place._replace(X=X), pin.FrameType.OP_FRAME)
    names = joint_names(model)
    for name, values in matching_limits(names, limits or {}).items():
        _set_limits(model, names.index(name), values)
    check_mass_matrix(model)
    return model


class _Place(NamedTuple):
    """Place of a body in a Pinocchio model.

    Attributes:
        joint: number of the joint that moves the body.
        X: pose of the body in the frame of that joint.
        frame: number of the parent frame.
    """

    joint: int
    X: pin.SE3
    frame: int


def _add_body(mj: MjModel, model: pin.Model, b: int, parent: _Place) -> _Place:
    """Add a body of MuJoCo with its joints, inertia and frames; return its place.

    Args:
        mj: compiled model.
        model: Pinocchio model that is built.
        b: number of the body in `mj`.
        parent: place of its parent.

    Raises:
        ModelError: MuJoCo compensates its weight, or a joint is not supported.
    """
    name = body_name(mj, b)
    body = mj.body(b)
    if mj.body_gravcomp[b] != 0.0:
        raise ModelError(
            f"body {name!r} has gravcomp {mj.body_gravcomp[b]:g}: MuJoCo carries its weight, "
            "and so would the control law; set gravcomp to 0"
        )
    place = parent._replace(X=parent.X * pose(body.pos, body.quat))
    for j in joints_of(mj, b):
        place = _add_joint(mj, model, j, place)
    R = pin.Quaternion(*body.iquat).toRotationMatrix()
    about_centre = R @ np.diag(body.inertia) @ R.T
    inertia = pin.Inertia(body.mass[0], np.array(body.ipos), about_centre)
    if body.jntnum[0]:
        model.appendBodyToJoint(place.joint, inertia, place.X)
    else:
        place = place._replace(
            frame=_add_frame(model, f"{name}_weld", place, pin.FrameType.FIXED_JOINT, inertia)
        )
    _add_frame(model, name, place, pin.FrameType.BODY)
    return place


def _add_frame(
    model: pin.Model,
    name: str,
    place: _Place,
    kind: pin.FrameType,
    inertia: pin.Inertia | None = None,
) -> int:
    """Add a frame to a Pinocchio model and return its number.

    Args:
        model: Pinocchio model that is built.
        name: name of the frame.
        place: place of the frame.
        kind: type of the frame.
        inertia: inertia that is fixed to the frame; None: none.
    """
    own_inertia = inertia or pin.Inertia.Zero()
    return model.addFrame(pin.Frame(name, place.joint, place.frame, place.X, kind, own_inertia))


def _add_joint(mj: MjModel, model: pin.Model, j: int, body: _Place) -> _Place:
    """Add a joint of MuJoCo; return the place of the body that it moves.

    Args:
        mj: compiled model.
        model: Pinocchio model that is built.
        j: number of the joint in `mj`.
        body: place of the body before the joint is added.

    Raises:
        ModelError: a free or ball joint, or a spring.
    """
    name = joint_name(mj, j)
    joint = mj.joint(j)
    kind = joint.type[0]
    if kind in (_FREE, _BALL):
        raise ModelError(
            f"joint {name!r} is a {('free', 'ball')[kind]} joint (nq ≠ nv), which is not "
            "supported; build it from hinges and slides, or fix it"
        )
    if joint.stiffness[0] != 0.0:
        raise ModelError(
            f"joint {name!r} has a spring of {joint.stiffness[0]:g}, which the control law "
            "does not know; set its stiffness to 0"
        )
    # The joint's frame is at its anchor, with the axes of the body. MuJoCo states the pose of the
    # body for q = qpos0, Pinocchio for q = 0: the displacement by −qpos0 is between the two.
    make = pin.JointModelPrismaticUnaligned if kind == _SLIDE else pin.JointModelRevoluteUnaligned
    axis = np.array(joint.axis)
    anchor = pin.SE3(np.eye(3), np.array(joint.pos))
    X = body.X * _joint_displacement(kind, anchor.translation, -joint.qpos0[0] * axis) * anchor
    number = model.addJoint(body.joint, make(axis), X, name)
    frame = model.addJointFrame(number, body.frame)
    v = model.joints[number].idx_v
    model.armature[v] = joint.armature[0]
    model.damping[v] = joint.damping[0]
    lower, upper = joint.range if joint.limited[0] else (-np.inf, np.inf)
    limits = {
        "lower": lower,
        "upper": upper,
        "effort": _largest_effort(mj, j),
        "velocity": _UNLIMITED,
    }
    _set_limits(model, v, limits | {"dryFriction": joint.frictionloss[0]})
    return _Place(number, anchor.inverse(), frame)


def _set_limits(model: pin.Model, v: int, limits: Mapping[str, float]) -> None:
    """Set limits of a joint in a Pinocchio model.

    Args:
        model: Pinocchio model.
        v: index of the joint's velocity.
        limits: "lower" and "upper" position; of "effort", "velocity" and "dryFriction" the largest
            absolute value.
    """
    for key, value in limits.items():
        if key in ("lower", "upper"):
            getattr(model, f"{key}PositionLimit")[v] = value
            continue
        quantity = f"{key[0].upper()}{key[1:]}Limit"
        getattr(model, f"upper{quantity}")[v] = value
        getattr(model, f"lower{quantity}")[v] = -value


def _largest_effort(mj: MjModel, joint: int) -> float:
    """Largest torque (N m, N) that a joint and its actuators permit; `_UNLIMITED` without a limit.

    Args:
        mj: compiled model.
        joint: number of the joint.
    """
    joint_limit = _UNLIMITED
    if mj.jnt_actfrclimited[joint]:
        joint_limit = _symmetric_limit(mj.jnt_actfrcrange[joint])
    # a motor is limited by its force and, without a servo (bias type 0), by its control signal
    sum_of_motors = 0.0
    for a in motors_of(mj, joint):
        force = _UNLIMITED
        if mj.actuator_forcelimited[a]:
            force = _symmetric_limit(mj.actuator_forcerange[a])
        if mj.actuator_ctrllimited[a] and mj.actuator_biastype[a] == 0:
            gain = abs(mj.actuator_gainprm[a, 0])
            force = min(force, gain * _symmetric_limit(mj.actuator_ctrlrange[a]))
        if force < _UNLIMITED:
            force *= abs(mj.actuator_gear[a, 0])
        sum_of_motors += force
    return min(joint_limit, sum_of_motors) if sum_of_motors > 0.0 else joint_limit


def _symmetric_limit(limits: ArrayLike) -> float:
    """Largest magnitude that is within limits in both directions.

    Args:
        limits: (2,) lower and upper limit, whose smaller absolute value is returned.
    """
    return float(np.abs(limits).min())


# The arm without shapes, for MuJoCo ---------------------------------------------------------------


def mjcf_skeleton(path: Path, tip: str, sensor: str | None, locked: Mapping[str, float]) -> MjSpec:
    """Copy bodies, inertias and joints of the tip's kinematic tree, without shapes and actuators.

    Joints have neither losses nor springs; those in `locked` are welded. A tip that is a site
    becomes a body without mass. The site of the wrist sensor is called `wrist`.

    Args:
        path: the MJCF file.
        tip: body or site at the arm's end.
        sensor: body or site of the wrist sensor; None: no sensor.
        locked: positions (m, rad) of the joints to be welded, by name.

    Raises:
        ModelError: a locked joint moves its body after one that is not locked.
    """
    mj = compile_mjcf(path)
    import mujoco  # installed, as the file has been compiled

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False
    copies: dict[int, MjsBody] = {0: spec.worldbody}
    for b in bodies_of(mj, tip):
        original = mj.body(b)
        copies[b] = body = copies[mj.body_parentid[b]].add_body(
            name=body_name(mj, b),
            pos=original.pos,
            quat=original.quat,
            explicitinertial=True,
            mass=original.mass[0],
            ipos=original.ipos,
            iquat=original.iquat,
            inertia=original.inertia,
        )
        for j in joints_of(mj, b):
            joint = mj.joint(j)
            body.add_joint(
                name=joint_name(mj, j),
                type=mujoco.mjtJoint(joint.type[0]),
                pos=joint.pos,
                axis=joint.axis,
                ref=joint.qpos0[0],
                range=joint.range,
                limited=int(joint.limited[0]),
            )
    weld_joints(spec, locked)
    bodies = [mj.body(b).name for b in copies]
    if tip not in bodies:
        site = mj.site(tip)
        copies[site.bodyid[0]].add_body(name=tip, pos=site.pos, quat=site.quat)
    if sensor in bodies:
        spec.body(sensor).add_site(name="wrist")
    elif sensor is not None:
        site = mj.site(sensor)
        copies[site.bodyid[0]].add_site(name="wrist", pos=site.pos, quat=site.quat)
    return spec


def weld_joints(spec: MjSpec, locked: Mapping[str, float]) -> None:
    """Replace joints of an arm by welds at given positions.

    Args:
        spec: specification of the arm, which is changed.
        locked: positions (m, rad) of the joints to be welded, by name.

    Raises:
        ModelError: a locked joint moves its body after one that is not locked.
    """
    for joint in [joint for joint in spec.joints if joint.name in locked]:
        body = joint.parent
        if body.joints[0].name != joint.name:
            raise ModelError(
                f"joint {joint.name!r} is locked, and moves its body after "
                f"{body.joints[0].name!r}, which is not: give each its own body"
            )
        displacement = (locked[joint.name] - joint.ref) * np.array(joint.axis)
        X_moved = _joint_displacement(int(joint.type), np.array(joint.pos), displacement)
        X = placed(pose(body.pos, body.quat) * X_moved)
        body.pos = X["pos"]
        body.quat = X["quat"]
        spec.delete(joint)

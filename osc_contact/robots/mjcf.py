"""MJCF in, Pinocchio model out: MuJoCo compiles the file, the numbers are taken from its model."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import ParseError, iterparse

import numpy as np
import pinocchio as pin

from osc_contact.errors import ModelError, did_you_mean, missing
from osc_contact.robots.checks import JointLimits, matching_limits
from osc_contact.robots.model import check_mass_matrix, joint_names
from osc_contact.robots.urdf import MAX_BYTES, read_bytes
from osc_contact.spatial import Array

_NONE = 1e30  #: a limit that is none (N m, N, rad/s, m/s)
#: MuJoCo's numbers of joint types
_FREE = 0
_BALL = 1
_SLIDE = 2


def is_mjcf(path: Path | str) -> bool:
    """Whether a file is to be read as MJCF: it begins with <mujoco> and is not called .urdf.

    MuJoCo opens what meshes and includes an MJCF file names, wherever they lie; a URDF must not.
    A file larger than any robot's is not looked into.
    """
    file = Path(path)
    try:
        if file.suffix.lower() == ".urdf" or file.stat().st_size > MAX_BYTES:
            return False
        with file.open("rb") as stream:
            return next(iterparse(stream, ["start"]))[1].tag == "mujoco"
    except (OSError, ValueError, LookupError, ParseError, StopIteration):
        return False


def compile_mjcf(mjcf: Path | str | Any) -> Any:
    """The `MjModel` of a file, of a `MjSpec`, or itself.

    Raises:
        ModelError: MuJoCo is missing, or refuses the file; it is no MJCF file, or over 8 MiB.
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
        read_bytes(Path(mjcf))  # what is no file, or too large for a robot, is refused
        if not is_mjcf(mjcf):
            raise ModelError(
                f"{mjcf} is no MJCF file: these begin with <mujoco> and are not called .urdf. "
                "Arm.from_urdf reads URDFs"
            )
        return mujoco.MjModel.from_xml_path(str(mjcf))
    except (ValueError, mujoco.FatalError) as error:
        raise ModelError(f"{mjcf}: MuJoCo refuses it: {error}") from error


# Values of a compiled model ----------------------------------------------------------------------


def joint_name(mj: Any, joint: int) -> str:
    """Name of a joint by its number."""
    return mj.joint(joint).name or f"joint{joint}"


def body_name(mj: Any, body: int) -> str:
    """Name of a body by its number."""
    return mj.body(body).name or f"body{body}"


def joints_of(mj: Any, body: int) -> range:
    """Numbers of the joints that move a body in its parent."""
    first = mj.body_jntadr[body]
    return range(first, first + mj.body_jntnum[body])


def motors_of(mj: Any, joint: int) -> list[int]:
    """Numbers of the actuators that act on a joint directly."""
    direct = np.isin(mj.actuator_trntype, (0, 1))  # mjTRN_JOINT, mjTRN_JOINTINPARENT
    return list(np.flatnonzero(direct & (mj.actuator_trnid[:, 0] == joint)))


def couplings(mj: Any) -> dict[str, str]:
    """Joint → the joint that it follows by an <equality> of the file, "" where it is held."""
    found = {}
    for e in np.flatnonzero((mj.eq_type == 2) & (mj.eq_active0 != 0)):  # mjEQ_JOINT
        master = mj.eq_obj2id[e]
        found[joint_name(mj, mj.eq_obj1id[e])] = "" if master < 0 else joint_name(mj, master)
    return found


def bodies_of(mj: Any, tip: str | None) -> list[int]:
    """Bodies of the tip's kinematic tree; None: of all trees that do not begin with a free joint.

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
        known = filter(None, places)
        raise ModelError(
            f"the MuJoCo model has no body or site {tip!r}; {did_you_mean(tip, known)}"
        )
    if places[tip] == 0:
        raise ModelError(f"no joint moves {tip!r}: it is fixed to the world")
    return list(np.flatnonzero(root == root[places[tip]]))


def pose(position: Array, quaternion: Array) -> pin.SE3:
    """From MuJoCo's w, x, y, z."""
    return pin.SE3(pin.Quaternion(*quaternion), np.array(position))


def placed(X: pin.SE3) -> dict[str, Array]:
    """A pose as the arguments of MuJoCo's bodies, frames and sites."""
    xyzw = pin.Quaternion(X.rotation).coeffs()
    return {"pos": X.translation, "quat": np.roll(xyzw, 1)}


def _moved(kind: int, place: Array, displacement: Array) -> pin.SE3:
    """What a joint at a place does to what is behind it.

    Args:
        kind: MuJoCo's number of its type. place: (3,) m.
        displacement: (3,) along its axis (m, rad).
    """
    if kind == _SLIDE:
        return pin.SE3(np.eye(3), displacement)
    R = pin.exp3(displacement)
    return pin.SE3(R, place - R @ place)


# The Pinocchio model ------------------------------------------------------------------------------


def load_mjcf(
    mjcf: Path | str | Any,
    tip: str | None = None,
    *,
    limits: Mapping[str, JointLimits] | None = None,
) -> pin.Model:
    """The Pinocchio model of an MJCF file, or of a `MjModel`.

    Joints stand at MuJoCo's qpos, whatever their `ref`; armature, damping and frictionloss
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
            # beside its body, behind the same joint: a force sensor cuts before its body
            _add_frame(model, site.name, place._replace(X=X), pin.FrameType.OP_FRAME)
    names = joint_names(model)
    for name, given in matching_limits(names, limits or {}).items():
        _set_limits(model, names.index(name), given)
    check_mass_matrix(model)
    return model


class _Place(NamedTuple):
    """Where a body is: the joint it moves with, its pose there, the frame that carries it."""

    joint: int
    X: pin.SE3
    frame: int


def _add_body(mj: Any, model: pin.Model, b: int, parent: _Place) -> _Place:
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
    model: pin.Model, name: str, place: _Place, kind: Any, inertia: pin.Inertia | None = None
) -> int:
    carried = inertia or pin.Inertia.Zero()
    return model.addFrame(pin.Frame(name, place.joint, place.frame, place.X, kind, carried))


def _add_joint(mj: Any, model: pin.Model, j: int, body: _Place) -> _Place:
    """A joint where `body` stands; returns the place of the body behind it."""
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
    make = pin.JointModelPrismaticUnaligned if kind == _SLIDE else pin.JointModelRevoluteUnaligned
    axis = np.array(joint.axis)
    anchor = pin.SE3(np.eye(3), np.array(joint.pos))
    X = body.X * _moved(kind, anchor.translation, -joint.qpos0[0] * axis) * anchor
    number = model.addJoint(body.joint, make(axis), X, name)
    frame = model.addJointFrame(number, body.frame)
    v = model.joints[number].idx_v
    model.armature[v] = joint.armature[0]
    model.damping[v] = joint.damping[0]
    lower, upper = joint.range if joint.limited[0] else (-np.inf, np.inf)
    limits = {"lower": lower, "upper": upper, "effort": _effort(mj, j), "velocity": _NONE}
    _set_limits(model, v, limits | {"dryFriction": joint.frictionloss[0]})
    return _Place(number, anchor.inverse(), frame)


def _set_limits(model: pin.Model, v: int, limits: Mapping[str, float]) -> None:
    """Set position limits, and both limits ± of other quantities."""
    for key, value in limits.items():
        if key in ("lower", "upper"):
            getattr(model, f"{key}PositionLimit")[v] = value
            continue
        quantity = f"{key[0].upper()}{key[1:]}Limit"
        getattr(model, f"upper{quantity}")[v] = value
        getattr(model, f"lower{quantity}")[v] = -value


def _effort(mj: Any, joint: int) -> float:
    """Largest torque (N m, N): what joint and actuators permit; without a limit a huge number."""

    def least(limits: Any) -> float:
        return float(np.abs(limits).min())

    most = least(mj.jnt_actfrcrange[joint]) if mj.jnt_actfrclimited[joint] else _NONE
    strong = 0.0
    for a in motors_of(mj, joint):
        force = least(mj.actuator_forcerange[a]) if mj.actuator_forcelimited[a] else _NONE
        if mj.actuator_ctrllimited[a] and mj.actuator_biastype[a] == 0:
            force = min(force, abs(mj.actuator_gainprm[a, 0]) * least(mj.actuator_ctrlrange[a]))
        strong += abs(mj.actuator_gear[a, 0]) * force if force < _NONE else _NONE
    return min(most, strong) if strong > 0.0 else most


# The arm without shapes, for MuJoCo ---------------------------------------------------------------


def mjcf_skeleton(path: Path, tip: str, sensor: str | None, locked: Mapping[str, float]) -> Any:
    """A `MjSpec` of the tip's kinematic tree: bodies, inertias and joints, nothing else.

    Joints carry neither losses nor springs; those in `locked` are welded where they are held. A
    tip that is a site becomes a body without mass; a sensor's site is called `wrist`, as is one in
    the body of that name.

    Args:
        path: the MJCF file.
        tip: body or site at the arm's end.
        sensor: site of the wrist sensor, if there is one.
        locked: positions (m, rad) of the joints that are held.

    Raises:
        ModelError: a locked joint moves its body after one that is not locked.
    """
    mj = compile_mjcf(path)
    import mujoco  # it is there: the file has been compiled

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False
    made: dict[int, Any] = {0: spec.worldbody}
    for b in bodies_of(mj, tip):
        given = mj.body(b)
        made[b] = body = made[mj.body_parentid[b]].add_body(
            name=body_name(mj, b),
            pos=given.pos,
            quat=given.quat,
            explicitinertial=True,
            mass=given.mass[0],
            ipos=given.ipos,
            iquat=given.iquat,
            inertia=given.inertia,
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
    bodies = [mj.body(b).name for b in made]
    if tip not in bodies:
        at = mj.site(tip)
        made[at.bodyid[0]].add_body(name=tip, pos=at.pos, quat=at.quat)
    if sensor in bodies:
        spec.body(sensor).add_site(name="wrist")
    elif sensor is not None:
        at = mj.site(sensor)
        made[at.bodyid[0]].add_site(name="wrist", pos=at.pos, quat=at.quat)
    return spec


def weld_joints(spec: Any, locked: Mapping[str, float]) -> None:
    """Weld bodies of a `MjSpec` where their joints are held.

    Args:
        spec: the arm. locked: positions (m, rad) of the joints that are held.

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
        moved = _moved(int(joint.type), np.array(joint.pos), displacement)
        X = placed(pose(body.pos, body.quat) * moved)
        body.pos = X["pos"]
        body.quat = X["quat"]
        spec.delete(joint)

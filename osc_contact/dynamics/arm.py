"""Model of one arm: loading, effort limits, losses and rotor inertia of its joints."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np
import pinocchio as pin

from osc_contact import robots
from osc_contact.dynamics.chain_state import scaled_inertia
from osc_contact.errors import ModelError
from osc_contact.robots.model import joint_names, position_limits, rotors, sliding
from osc_contact.spatial import Array, norm

if TYPE_CHECKING:
    from osc_contact.robots.mjcf import MjcfSource

PerJoint = float | Sequence[float] | Array  #: a number for all joints, or one for each

_NO_LIMIT = 1e12  #: larger effort limits mean that a motor has no limit (N m, N)
#: Field of Pinocchio's model for each quantity of the joints.
_PER_JOINT = {"armature": "armature", "damping": "damping", "friction": "upperDryFrictionLimit"}


def effort_limits(model: pin.Model, actuated: Array) -> Array:
    """Read the effort limits (n_a,) of motors (N m, N); inf for motors without a limit.

    Args:
        model: model of the joints.
        actuated: (n_a,) indices of the joints with motors.

    Raises:
        ModelError: a limit that is not positive.
    """
    limits = np.array(model.upperEffortLimit)[actuated]
    for j, limit in zip(actuated, limits, strict=True):
        if not limit > 0.0:
            name = model.names[int(j) + 1]
            raise ModelError(
                f"joint '{name}' has an effort limit of {limit:g}: such a motor does "
                "nothing. Give its largest torque (N m) or force (N), or list it among the passive "
                "joints"
            )
    return np.where(limits < _NO_LIMIT, limits, np.inf)


def effort_scale(tau_max: Array) -> Array:
    """Units (n_a,) in which torques are compared: τ_max, for unlimited motors the largest τ_max.

    Args:
        tau_max: (n_a,) effort limits (N m, N). If all are inf, the units are 1.
    """
    finite = np.isfinite(tau_max)
    if not finite.any():
        return np.ones(len(tau_max))
    return np.where(finite, tau_max, tau_max[finite].max())


def rotor_inertia(model: pin.Model) -> Array:
    """Rotor inertia (n,) reflected to each joint (kg m²; kg), which is added to M's diagonal.

    It is the model's armature or, if that is zero, rotorInertia · rotorGearRatio².

    Raises:
        ModelError: a rotor inertia is negative or not finite.
    """
    inertia = rotors(model)
    for name, value in zip(joint_names(model), inertia, strict=True):
        if not 0.0 <= value < np.inf:
            raise ModelError(
                f"joint '{name}' has a rotor inertia of {value:g}; give armature (kg m², kg) ≥ 0"
            )
    return inertia


def heaviest_rotor(model: pin.Model, gyration: float) -> float:
    """Mass (kg) whose inertia at a radius of gyration equals the largest rotor inertia.

    Args:
        model: model of the joints; for a sliding joint the mass is its rotor inertia itself.
        gyration: radius of gyration (m).
    """
    masses = rotor_inertia(model) / np.where(sliding(model), 1.0, gyration**2)
    return float(masses.max(initial=0.0))


def with_joints(
    model: pin.Model, values: Mapping[str, PerJoint | None], friction_factor: float
) -> pin.Model:
    """Replace losses and rotor inertias of the joints in a copy of a model.

    Without changes the model itself is returned.

    Args:
        model: model of one arm.
        values: new "armature", "damping" and "friction", see `Arm.from_urdf`; None: unchanged.
        friction_factor: factor of damping and friction, of new values and of the model's.

    Raises:
        ModelError: not one number for each joint, or a number that is negative or not finite.
    """
    values = {key: x for key, x in values.items() if x is not None}
    if not values and friction_factor == 1.0:
        return model
    model = model.copy()
    for key, value in values.items():
        numbers = np.asarray(value, dtype=float)
        if numbers.shape not in ((), (model.nv,)):
            raise ModelError(
                f"{key}: {numbers.size} numbers for {model.nv} joints {joint_names(model)}; "
                "give one for each, or a single one for all"
            )
        if not (np.isfinite(numbers).all() and (numbers >= 0.0).all()):
            raise ModelError(f"{key} = {numbers.tolist()}; give finite numbers ≥ 0")
        setattr(model, _PER_JOINT[key], np.full(model.nv, numbers))
        if key == "armature":
            model.rotorInertia = np.zeros(model.nv)
    model.damping = model.damping * friction_factor
    model.upperDryFrictionLimit = model.upperDryFrictionLimit * friction_factor
    model.lowerDryFrictionLimit = -model.upperDryFrictionLimit
    return model


_logger = logging.getLogger("osc_contact.robots")


class ArmOptions(TypedDict, total=False):
    """Arguments of `Arm.from_urdf` that `Arm.from_mjcf` takes, too."""

    base: pin.SE3 | None
    passive_joints: Sequence[str]
    wrist_sensor: str | None
    locked: Mapping[str, float] | None
    mass_factor: float
    effort_factor: float
    armature: PerJoint | None
    damping: PerJoint | None
    friction: PerJoint | None
    friction_factor: float


@dataclass(frozen=True)
class Arm:
    """Model of a serial arm; build it with `Arm.from_urdf`.

    Attributes:
        name: prefix of its joints in the merged model ("left" → "left/joint1").
        model: Pinocchio model of the joints between base and tip.
        tip: name of the frame that grasps.
        base: pose of the arm's base in the world.
        passive_joints: names of joints without a motor (gripper hinges).
        wrist_sensor: frame of the 6-axis force/torque sensor, which measures all bodies outboard
            of it. None: no sensor.
        locked: positions of the URDF's other joints, which are held (m, rad).

    Example:
        >>> from osc_contact import robots
        >>> urdf = robots.find_robot("panda")[0]
        >>> arm = osc.Arm.from_urdf(
        ...     urdf, name="panda", tip="panda_hand_tcp", wrist_sensor="panda_link7"
        ... )
        >>> print(arm.name, arm.model.nq)
        panda 7
    """

    name: str
    model: pin.Model
    tip: str
    base: pin.SE3
    passive_joints: tuple[str, ...] = ()
    wrist_sensor: str | None = None
    locked: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def from_urdf(
        cls,
        urdf: str | Path | pin.Model,
        *,
        name: str,
        tip: str,
        base: pin.SE3 | None = None,
        passive_joints: Sequence[str] = (),
        wrist_sensor: str | None = None,
        locked: Mapping[str, float] | None = None,
        mass_factor: float = 1.0,
        effort_factor: float = 1.0,
        armature: PerJoint | None = None,
        damping: PerJoint | None = None,
        friction: PerJoint | None = None,
        friction_factor: float = 1.0,
    ) -> Arm:
        """Load an arm; joints that do not move the tip (fingers) are locked.

        Args:
            urdf: path of a URDF (checked as by `robots.load_model` with its defaults) or of an MJCF
                file (see `from_mjcf`), or a ready Pinocchio model, for example of
                `robots.load_model` with other limits.
            name: prefix that distinguishes equal robots.
            tip: frame that holds the object.
            base: pose of the URDF's root in the world (default: the origin).
            passive_joints: joints without a motor.
            wrist_sensor: frame of the wrist force/torque sensor.
            locked: positions of joints to be locked (m, rad); other joints that do not move the tip
                are locked at neutral.
            mass_factor: factor of all link masses and inertias (to study model error).
            effort_factor: factor of all effort limits (to study weak motors).
            armature: rotor inertia reflected to the joints in place of the model's (kg m²; kg of a
                sliding joint). It is a number for all joints between base and tip, or one for
                each, as are damping and friction.
            damping: viscous friction of the joints in place of the model's (N m s/rad; N s/m).
            friction: dry friction of the joints in place of the model's (N m; N).
            friction_factor: factor of damping and friction (to study model error).

        Raises:
            ModelError: unreadable or impossible URDF, unknown frame or joint, no moving joint.
        """
        positions = {} if locked is None else locked
        robot, model, masters = _load_reduced(urdf, tip, positions, passive_joints, wrist_sensor)
        model = _with_factors(model, mass_factor, effort_factor)
        losses = {"armature": armature, "damping": damping, "friction": friction}
        model = with_joints(model, losses, friction_factor)
        moving = joint_names(model)
        arm = cls(
            name=name,
            model=model,
            tip=tip,
            base=pin.SE3.Identity() if base is None else base,
            passive_joints=tuple(passive_joints),
            wrist_sensor=wrist_sensor,
            locked={j: positions.get(j, 0.0) for j in joint_names(robot) if j not in moving},
        )
        _warn_of_followers(arm, masters)
        return arm

    @classmethod
    def from_mjcf(
        cls,
        mjcf: MjcfSource,
        *,
        name: str,
        tip: str,
        tip_offset: pin.SE3 | None = None,
        limits: Mapping[str, robots.JointLimits] | None = None,
        **how: Unpack[ArmOptions],
    ) -> Arm:
        """Load an arm from MJCF, with armature, damping and friction of its joints.

        Only the kinematic tree of the tip is read. Without `base` the file determines the pose of
        the arm in the world.

        Args:
            mjcf: path of an MJCF file, `mujoco.MjSpec` or `mujoco.MjModel`.
            name: prefix that distinguishes equal robots.
            tip: body or site that holds the object.
            tip_offset: pose, in the frame of `tip`, of the operational point; it becomes the arm's
                tip, a frame named after `tip`. None: `tip` itself.
            limits: limits by hand, see `robots.load_mjcf`.
            **how: further arguments of `from_urdf`. The wrist sensor is a site with force and
                torque sensors, or a body; it measures the load of that body and all beyond it.

        Raises:
            ModelError: see `robots.load_mjcf`, `from_urdf`.
        """
        mj = robots.compile_mjcf(mjcf)
        model = robots.load_mjcf(mj, tip, limits=limits)
        if tip_offset is not None:
            model, tip = _with_point(model, tip, tip_offset)
        arm = cls.from_urdf(model, name=name, tip=tip, **how)
        masters = robots.couplings(mj)
        _require_uncoupled(arm.model, masters)
        _warn_of_followers(arm, masters)
        return arm


def _with_point(model: pin.Model, tip: str, X: pin.SE3) -> tuple[pin.Model, str]:
    """Copy a model and add a frame "`tip` point".

    Args:
        model: model of one arm.
        tip: name of a frame.
        X: pose of the new frame in the frame `tip`.

    Returns:
        The copy, and the name of the new frame.
    """
    model = model.copy()
    tip_id = robots.frame_id(model, tip)
    frame = model.frames[tip_id]
    name = f"{tip} point"
    kind = pin.FrameType.OP_FRAME
    model.addFrame(pin.Frame(name, frame.parentJoint, tip_id, frame.placement * X, kind))
    return model, name


def _load_reduced(
    urdf: str | Path | pin.Model,
    tip: str,
    positions: Mapping[str, float],
    passive_joints: Sequence[str],
    wrist_sensor: str | None,
) -> tuple[pin.Model, pin.Model, Mapping[str, str]]:
    """Load a robot, reduce its model to the joints that move the tip, and check the names.

    Args:
        urdf: path or name of the robot's file, or its Pinocchio model.
        tip: name of the frame that holds the object.
        positions: positions of joints to be locked, by name (rad, m).
        passive_joints: names of joints without a motor.
        wrist_sensor: name of the wrist sensor's frame, or None.

    Returns:
        Model of the whole robot, model of the joints that move the tip, and the name of the master
        joint of each joint that follows one.

    Raises:
        ModelError: the file cannot be read, a name is unknown, no joint moves the tip, a joint that
            does follows another one, or a given model is not sound.
    """
    robot, masters = _whole_robot(urdf, tip)
    _require_joints(robot, (*passive_joints, *positions))
    model = _path_to(robot, robots.frame_id(robot, tip), positions)
    _require_uncoupled(model, masters)
    if isinstance(urdf, pin.Model):
        _require_sound(model)
    _require_joints(model, passive_joints)
    if wrist_sensor is not None:
        robots.frame_id(model, wrist_sensor)  # raises ModelError for an unknown frame
    return robot, model, masters


def _whole_robot(urdf: str | Path | pin.Model, tip: str) -> tuple[pin.Model, Mapping[str, str]]:
    """Load the model of all joints of a robot, and find the joints that follow other joints.

    Args:
        urdf: path or name of the robot's file, or its Pinocchio model.
        tip: name of the frame that holds the object.

    Returns:
        Model of the robot, and the name of the master joint of each joint that follows one.

    Raises:
        ModelError: the file cannot be read.
    """
    if not isinstance(urdf, pin.Model):
        return robots.load_robot(urdf, tip)
    pairs = zip(urdf.mimicking_joints, urdf.mimicked_joints, strict=True)
    return (urdf, {urdf.names[a]: urdf.names[b] for a, b in pairs})


def stretched_length(arm: Arm) -> float:
    """Upper bound of the distance of an arm's tip from its base (m): all links in one line."""
    model = arm.model
    tip = model.frames[robots.frame_id(model, arm.tip)]
    links = [X.translation for X in (*model.jointPlacements, tip.placement)]
    low, high = position_limits(model)
    slides = np.maximum(np.abs(low), np.abs(high))[sliding(model)]
    return float(sum(map(norm, links)) + slides.sum())


def _require_joints(model: pin.Model, names: Sequence[str]) -> None:
    """Refuse names that are not moving joints of a model.

    Raises:
        ModelError: a name is unknown; the message lists the joints.
    """
    missing = [name for name in names if name not in joint_names(model)]
    if missing:
        raise ModelError(
            f"no moving joint called {missing[0]!r} on the way to the tip; "
            f"there are {joint_names(model)}"
        )


def _require_uncoupled(model: pin.Model, masters: Mapping[str, str]) -> None:
    """Refuse joints that move the tip and follow another joint, or are held by the file.

    Args:
        model: model of the joints between base and tip.
        masters: name of the master joint by the name of each joint that follows one; "" for a joint
            that the file holds still.

    Raises:
        ModelError: a joint of the model follows a master or is held.
    """
    for name in joint_names(model):
        if name in masters:
            master = f"joint {masters[name]!r}" if masters[name] else "no other and is held"
            raise ModelError(
                f"joint {name!r} on the way to the tip follows {master}: one motor moves both, and "
                "the control law takes every joint as free. Lock both where they stand (locked=, "
                "arms.locked_joints), choose a tip before it, or leave the coupling out if it has "
                "its own motor"
            )


def _warn_of_followers(arm: Arm, masters: Mapping[str, str]) -> None:
    """Warn of locked joints whose master moves the tip, so that their motion is neglected.

    Args:
        arm: the arm.
        masters: name of the master joint by the name of each joint that follows one; "" for a joint
            that the file holds still.
    """
    for name, master in masters.items():
        if master in list(arm.model.names) and name in arm.locked:
            _logger.warning(
                "joint %r follows %r, which moves the tip; it is locked at %g, and bodies that "
                "move with it are neglected. Lock %r too (locked=, arms.locked_joints), or leave "
                "the coupling out",
                name,
                master,
                arm.locked[name],
                master,
            )


def _require_sound(model: pin.Model) -> None:
    """Refuse a ready model with nq ≠ nv, or with a mass matrix that is not positive definite.

    Raises:
        ModelError: a joint with nq ≠ nv, or joints that move without moving mass.
    """
    for name, joint in zip(joint_names(model), list(model.joints)[1:], strict=True):
        if joint.nq != joint.nv:
            raise ModelError(
                f"joint {name!r} ({joint.shortname()}) has nq = {joint.nq} but nv = {joint.nv}; "
                "load the URDF by its path or with robots.load_model, which make a continuous "
                "joint a revolute one without end stops"
            )
    robots.check_mass_matrix(model)


def _path_to(model: pin.Model, tip: int, positions: Mapping[str, float]) -> pin.Model:
    """Lock all joints of a robot that do not move the tip; return the reduced model.

    Args:
        model: model of the robot.
        tip: number of the tip's frame.
        positions: positions of joints to be locked, by name (rad, m); other joints that do not move
            the tip are locked at neutral.

    Raises:
        ModelError: no joint remains.
    """
    on_path = set(model.supports[model.frames[tip].parentJoint])
    q = pin.neutral(model)
    for name, position in positions.items():
        q[model.joints[model.getJointId(name)].idx_q] = position
    locked_joints = [
        j for j in range(1, model.njoints) if model.names[j] in positions or j not in on_path
    ]
    if not locked_joints:
        return model
    if len(locked_joints) == model.njoints - 1:
        raise ModelError(f"no joint moves the tip frame '{model.frames[tip].name}'")
    model = model.copy()
    names = with_distinct_frames(model)
    reduced = pin.buildReducedModel(model, locked_joints, q)
    for frame in reduced.frames:  # Pinocchio 4.1 leaves some frames their own parents
        original = model.frames[model.getFrameId(frame.name)]
        frame.parentFrame = reduced.getFrameId(model.frames[original.parentFrame].name)
        if original.type == pin.FrameType.JOINT and frame.type == pin.FrameType.FIXED_JOINT:
            frame.inertia = _own_inertia(model, original.parentJoint)
    for frame in reduced.frames:
        frame.name = names[frame.name]
    return reduced


def _own_inertia(model: pin.Model, joint: int) -> pin.Inertia:
    """Inertia of the link that a joint moves, in the joint's frame, without links welded to it.

    Pinocchio adds welded links to the inertia of their joint, and keeps a copy at their frames.

    Args:
        model: model of the robot.
        joint: number of the joint.
    """
    total = model.inertias[joint]
    welded = pin.Inertia.Zero()
    for frame in model.frames:
        if frame.parentJoint == joint:
            welded = welded + frame.placement.act(frame.inertia)
    massless = welded.mass > (1.0 - 1e-12) * total.mass
    return pin.Inertia.Zero() if massless else total - welded


def with_distinct_frames(model: pin.Model) -> dict[str, str]:
    """Append numbers to the names of a model's links, which may have names of joints.

    Functions of Pinocchio find frames by name only.

    Returns:
        The old name of each frame by its new name.
    """
    joints = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    names = {}
    for i, frame in enumerate(model.frames):
        mark = "" if i == 0 or frame.type in joints else f"#{i}"
        names[frame.name + mark] = frame.name
        frame.name += mark
    return names


def _with_factors(model: pin.Model, mass_factor: float, effort_factor: float) -> pin.Model:
    """Scale a copy of a model; if both factors are 1, return the model itself.

    Args:
        model: model of one arm.
        mass_factor: factor of masses and inertias.
        effort_factor: factor of the effort limits.
    """
    if mass_factor == 1.0 and effort_factor == 1.0:
        return model
    scaled_model = model.copy()
    if mass_factor != 1.0:
        for j in range(1, scaled_model.njoints):
            scaled_model.inertias[j] = scaled_inertia(scaled_model.inertias[j], mass_factor)
        for frame in scaled_model.frames:
            frame.inertia = scaled_inertia(frame.inertia, mass_factor)
    if effort_factor != 1.0:
        scaled_model.upperEffortLimit *= effort_factor
        scaled_model.lowerEffortLimit *= effort_factor
    return scaled_model

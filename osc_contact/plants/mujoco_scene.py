"""The MuJoCo model of a rig, put together from the same URDFs as the toolkit's own.

The object hangs on the first arm's gripper, further arms hold it by welds. Only the object and the
bodies of the environment touch, with the collision geometry of their URDFs and soft enough not to
chatter; joints have neither damping nor friction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.plants.faces import Rail
from osc_contact.spatial import Array

__all__ = ["DRIVE_MASS", "MujocoOptions", "scene"]

#: Heavy enough that no contact force moves a driven face between two steps (kg).
DRIVE_MASS = 1e6


@dataclass(frozen=True)
class MujocoOptions:
    """Integration step (s), contact softness and Coulomb friction of the environment."""

    step: float = 2.5e-4
    solref: tuple[float, float] = (0.01, 1.0)
    solimp: tuple[float, float, float] = (0.2, 0.9, 0.0005)
    friction: float = 0.0


def scene(
    mujoco: Any,
    chain: ClosedChain,
    arm_urdfs: Sequence[Path],
    object_urdf: Path,
    bodies: Sequence[tuple[Path, pin.SE3]],
    options: MujocoOptions,
    rails: Sequence[Rail | None],
) -> Any:
    """The uncompiled specification, see `MujocoPlant`."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False
    spec.option.timestep = options.step
    spec.option.tolerance = 1e-12
    spec.option.iterations = 100
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    off = mujoco.mjtDisableBit
    disabled = off.mjDSBL_AUTORESET | off.mjDSBL_MIDPHASE  # few geometries, all looked at
    if not any(rails):  # all that is constrained hangs together
        disabled |= off.mjDSBL_ISLAND
    spec.option.disableflags = int(disabled)
    for arm, urdf in zip(chain.arms, arm_urdfs, strict=True):
        part = mujoco.MjSpec.from_string(_skeleton(urdf))
        part.compiler.fusestatic = False
        for joint in list(part.joints):
            if joint.name in arm.locked:
                _lock(mujoco, part, joint, arm.locked[joint.name])
        spec.attach(part, prefix=f"{arm.name}/", frame=_frame(spec.worldbody, arm.base))
        if arm.wrist_sensor is not None:
            _wrist_sensor(mujoco, spec, arm.name, arm.wrist_sensor)
    for index in chain.actuated:
        name = chain.joint_names[index]
        limit = float(chain.model.upperEffortLimit[index])
        motor = spec.add_actuator(
            name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrlrange=[-limit, limit]
        )
        motor.set_to_motor()
    _hold_object(mujoco, spec, chain, object_urdf)
    for i, (body, rail) in enumerate(zip(bodies, rails, strict=True)):
        _body(mujoco, spec, i, *body, options, rail)
    return spec


def _skeleton(urdf: Path) -> str:
    """A robot's URDF without shapes, which may be meshes, and without losses in its joints."""
    root = ElementTree.parse(urdf).getroot()
    for element in root.iter():
        for tag in ("visual", "collision", "dynamics"):
            for child in element.findall(tag):
                element.remove(child)
    return ElementTree.tostring(root, encoding="unicode")


def _lock(mujoco: Any, part: Any, joint: Any, position: float) -> None:
    """Weld a link where its joint is held; a URDF's joints have the axes of their child links."""
    body, axis = joint.parent, np.array(joint.axis)
    pose, turn = np.zeros(3), np.zeros(4)
    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
        mujoco.mju_rotVecQuat(pose, position * axis, body.quat)
        body.pos = np.array(body.pos) + pose
    else:
        mujoco.mju_axisAngle2Quat(turn, axis, position)
        held = np.zeros(4)
        mujoco.mju_mulQuat(held, body.quat, turn)
        body.quat = held
    part.delete(joint)


def _frame(body: Any, X: pin.SE3) -> Any:
    x, y, z, w = pin.Quaternion(X.rotation).coeffs()
    return body.add_frame(pos=X.translation, quat=[w, x, y, z])


def _wrist_sensor(mujoco: Any, spec: Any, arm: str, frame: str) -> None:
    spec.body(f"{arm}/{frame}").add_site(name=f"{arm}/wrist")
    for kind in ("force", "torque"):
        spec.add_sensor(
            name=f"{arm}/{kind}",
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}"),
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=f"{arm}/wrist",
        )


def _hold_object(mujoco: Any, spec: Any, chain: ClosedChain, urdf: Path) -> None:
    """The object rides on the first arm; welds tie it to the others."""
    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    for geom in part.geoms:
        geom.contype, geom.conaffinity = 0, 1
    root = part.worldbody.first_body()
    root.name = "root"
    root.add_site(name="held")
    first = chain.arms[0]
    spec.attach(
        part,
        prefix="object/",
        frame=_frame(spec.body(f"{first.name}/{first.tip}"), chain.grasps[0]),
    )
    for arm, X_TO in zip(chain.arms[1:], chain.grasps[1:], strict=True):
        x, y, z, w = pin.Quaternion(X_TO.rotation).coeffs()
        spec.body(f"{arm.name}/{arm.tip}").add_site(
            name=f"{arm.name}/hold", pos=X_TO.translation, quat=[w, x, y, z]
        )
        spec.add_equality(
            name=f"{arm.name}/weld",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            name1=f"{arm.name}/hold",
            name2="object/held",
            solref=[2 * spec.option.timestep, 1.0],
            solimp=[0.9999, 0.9999, 0.001, 0.5, 2.0],
            data=[0.0] * 10 + [1.0, 0.0],  # torque scale of the weld
        )


def _body(
    mujoco: Any,
    spec: Any,
    i: int,
    urdf: Path,
    placement: pin.SE3,
    options: MujocoOptions,
    rail: Rail | None,
) -> None:
    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    root = part.worldbody.first_body()
    root.name = "root"
    for geom in part.geoms:
        geom.contype, geom.conaffinity = 1, 0
        geom.priority = 1
        geom.solref = list(options.solref)
        geom.solimp = [*options.solimp, 0.5, 2.0]
        geom.condim = 1 if options.friction == 0.0 else 3
        geom.friction = [options.friction, 0.0, 0.0]
    if rail is not None:
        _put_on_rail(mujoco, part, root, placement.rotation.T @ rail.direction, rail)
    spec.attach(part, prefix=f"face{i}/", frame=_frame(spec.worldbody, placement))


def _put_on_rail(mujoco: Any, part: Any, root: Any, axis: Array, rail: Rail) -> None:
    """A slide joint; the cart's mass, or that of its drive, is all the mass there is."""
    driven = rail.motion is not None
    for body in part.bodies[1:]:  # links fixed to the body weigh nothing beside it
        body.explicitinertial = True
        body.fullinertia = [np.nan] * 6  # not given
        body.mass, body.inertia = 0.0, [0.0] * 3
    root.mass = DRIVE_MASS if driven else rail.mass
    root.inertia = [root.mass] * 3
    root.gravcomp = 1.0 if driven else 0.0
    root.add_joint(
        name="rail",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=axis,
        stiffness=0.0 if driven else rail.stiffness,
        damping=0.0 if driven else rail.damping,
    )

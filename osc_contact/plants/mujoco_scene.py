"""The MuJoCo model of a rig, put together from the same files as the toolkit's own.

The object hangs on the first arm's gripper, welded or by a joint of the grasp's kind; equality
constraints tie it to the others: a weld, one point (ball) or two points of an axis (hinge). Only
the object and the bodies of the environment touch, with the collision geometry of their URDFs and
soft enough not to chatter. Rotor inertia, damping and friction of the joints are the chain's.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.grasp import Grasp
from osc_contact.errors import PlantError
from osc_contact.plants.faces import Rail
from osc_contact.robots import is_mjcf
from osc_contact.robots.mjcf import mjcf_skeleton
from osc_contact.scenarios.hardware import PlantSpec
from osc_contact.spatial import Array

__all__ = ["DRIVE_MASS", "GRASP_JOINT", "GUIDES", "scene"]

#: The joint between the first arm's tip and the object, if its grasp is a hinge or a ball.
GRASP_JOINT = "object/grasp"
#: Distance of the two points that make a hinge from the tip's origin (m).
HINGE_SPAN = 0.05

#: Heavy enough that no contact force moves a driven face between two steps (kg, kg m²).
DRIVE_MASS = 1e6
GUIDES = ("slide", "hinge")  #: joints of a body that moves
_NEXT_TO_NOTHING = 1e-9  # kg, kg m²: MuJoCo needs mass in moving bodies


def scene(
    mujoco: Any,
    chain: ClosedChain,
    arm_urdfs: Sequence[Path],
    object_urdf: Path,
    bodies: Sequence[tuple[Path, pin.SE3]],
    options: PlantSpec,
    rails: Sequence[Rail | None],
) -> Any:
    """The uncompiled specification, see `MujocoPlant`.

    Args:
        mujoco: the module. chain: of the arms. arm_urdfs, object_urdf: their files.
        bodies: URDF and pose of each body touched. options: of the plant.
        rails: how each body moves; None: at rest.
    """
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
        part = _arm(mujoco, arm, urdf)
        spec.attach(part, prefix=f"{arm.name}/", frame=_frame(spec.worldbody, arm.base))
        if arm.wrist_sensor is not None:
            _wrist_sensor(mujoco, spec, arm.name)
    _joint_numbers(spec, chain)
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
    if options.friction > 0.0 and options.own_friction != options.solref:
        _let_slide(spec, options, options.own_friction)
    return spec


def _arm(mujoco: Any, arm: Arm, file: Path) -> Any:
    """An arm without shapes and losses, locked joints welded, a site where its wrist sensor is."""
    if is_mjcf(file):
        return mjcf_skeleton(mujoco, file, arm.tip, arm.wrist_sensor, arm.locked)
    part = mujoco.MjSpec.from_string(_skeleton(file))
    part.compiler.fusestatic = False
    for joint in list(part.joints):
        if joint.name in arm.locked:
            _lock(mujoco, part, joint, arm.locked[joint.name])
    if arm.wrist_sensor is not None:
        part.body(arm.wrist_sensor).add_site(name="wrist")
    return part


def _skeleton(urdf: Path) -> str:
    """A robot's URDF without shapes, which may be meshes, and without losses in its joints."""
    return _without_shapes(urdf.read_bytes())


@lru_cache(maxsize=32)
def _without_shapes(text: bytes) -> str:
    root = ElementTree.fromstring(text)
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


def _joint_numbers(spec: Any, chain: ClosedChain) -> None:
    """Rotor inertia, damping and dry friction of every joint, as the chain has them."""
    model = chain.model
    for i, name in enumerate(chain.joint_names):
        joint = spec.joint(name)
        joint.armature, joint.damping = float(model.armature[i]), [model.damping[i], 0.0, 0.0]
        joint.frictionloss = dry = float(model.upperDryFrictionLimit[i])
        if dry > 0.0:  # MuJoCo's own 20 ms would turn it round 10 ms before the joint
            joint.solref_friction = [2 * spec.option.timestep, 1.0]


def _frame(body: Any, X: pin.SE3) -> Any:
    x, y, z, w = pin.Quaternion(X.rotation).coeffs()
    return body.add_frame(pos=X.translation, quat=[w, x, y, z])


def _wrist_sensor(mujoco: Any, spec: Any, arm: str) -> None:
    for kind in ("force", "torque"):
        spec.add_sensor(
            name=f"{arm}/{kind}",
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}"),
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname=f"{arm}/wrist",
        )


def _hold_object(mujoco: Any, spec: Any, chain: ClosedChain, urdf: Path) -> None:
    """The object rides on the first arm; equality constraints tie it to the others."""
    for arm, grasp in zip(chain.arms, chain.grasps, strict=True):
        if grasp.kind == "other":
            raise PlantError(
                f"arm '{arm.name}': MuJoCo is given rigid, hinge and ball grasps only; "
                "use the rigid plant"
            )
    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    for geom in part.geoms:
        geom.contype, geom.conaffinity = 0, 1
    root = part.worldbody.first_body()
    root.name = "root"
    root.add_site(name="held")
    _weigh(root, chain)
    first = chain.grasps[0]
    for i, grasp in enumerate(chain.grasps[1:], start=1):
        for k, point in enumerate(_tie_points(grasp)):
            root.add_site(name=f"tie{i}.{k}", pos=grasp.X_TO.actInv(point))
    if not first.is_rigid:
        axis = np.zeros(3) if first.kind == "ball" else first.X_TO.rotation.T @ first.T[3:, 0]
        root.add_joint(
            name="grasp",
            type=getattr(mujoco.mjtJoint, f"mjJNT_{first.kind.upper()}"),
            pos=first.X_TO.inverse().translation,
            **({} if first.kind == "ball" else {"axis": axis}),
        )
    tip = spec.body(f"{chain.arms[0].name}/{chain.arms[0].tip}")
    spec.attach(part, prefix="object/", frame=_frame(tip, first.X_TO))
    for i, (arm, grasp) in enumerate(zip(chain.arms[1:], chain.grasps[1:], strict=True), start=1):
        tip = spec.body(f"{arm.name}/{arm.tip}")
        if grasp.is_rigid:
            x, y, z, w = pin.Quaternion(grasp.X_TO.rotation).coeffs()
            tip.add_site(name=f"{arm.name}/hold", pos=grasp.X_TO.translation, quat=[w, x, y, z])
            tie = _tie(mujoco, spec, f"{arm.name}/weld", f"{arm.name}/hold", "object/held")
            tie.type = mujoco.mjtEq.mjEQ_WELD
            tie.data = [0.0] * 10 + [1.0, 0.0]  # torque scale of the weld
        for k, point in enumerate(_tie_points(grasp)):
            own, other = f"{arm.name}/tie.{k}", f"object/tie{i}.{k}"
            tip.add_site(name=own, pos=point)
            _tie(mujoco, spec, own, own, other).type = mujoco.mjtEq.mjEQ_CONNECT


def _weigh(root: Any, chain: ClosedChain) -> None:
    """The chain's object where that is not the one of the file."""
    assert chain.payload is not None
    inertia = chain.payload.inertia
    if inertia.mass == root.mass:
        return
    I = inertia.inertia  # noqa: E741 - the field's letter
    root.explicitinertial = True
    root.mass, root.ipos, root.iquat = inertia.mass, inertia.lever, [1.0, 0.0, 0.0, 0.0]
    root.fullinertia = [I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]


def _tie_points(grasp: Grasp) -> list[Array]:
    """Points of the tip frame that stay together in a hinge or a ball."""
    if grasp.is_rigid:
        return []
    if grasp.kind == "ball":
        return [np.zeros(3)]
    axis = grasp.T[3:, 0]
    return [HINGE_SPAN * axis, -HINGE_SPAN * axis]


def _tie(mujoco: Any, spec: Any, name: str, first: str, second: str) -> Any:
    return spec.add_equality(
        name=name,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        name1=first,
        name2=second,
        solref=[2 * spec.option.timestep, 1.0],
        solimp=[0.9999, 0.9999, 0.001, 0.5, 2.0],
    )


def _body(
    mujoco: Any,
    spec: Any,
    i: int,
    urdf: Path,
    placement: pin.SE3,
    options: PlantSpec,
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
        _put_on_rail(mujoco, part, root, placement, rail)
    spec.attach(part, prefix=f"face{i}/", frame=_frame(spec.worldbody, placement))


def _let_slide(spec: Any, options: PlantSpec, own: tuple[float, float]) -> None:
    """Friction with a separate solref, between the object's geometries and those of all bodies.

    MuJoCo's cone lifts what slides: the depth that carries a force shrinks by 2 μ v τ d, v the
    speed, τ the time constant of friction and d the impedance. A point settles there, a face on a
    face hops. With a longer τ it is lifted less; friction then has the impedance times the same
    ratio, so that the slip from which on it is developed stays.
    """
    spec.option.impratio = own[0] / options.solref[0]
    for i, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"geom{i}"
    held = [geom.name for geom in spec.geoms if geom.conaffinity and not geom.contype]
    touched = [geom.name for geom in spec.geoms if geom.contype and not geom.conaffinity]
    for first in held:
        for second in touched:
            pair = spec.add_pair(geomname1=first, geomname2=second)
            pair.condim, pair.friction = 3, [options.friction, options.friction, 0.0, 0.0, 0.0]
            pair.solref, pair.solimp = list(options.solref), [*options.solimp, 0.5, 2.0]
            pair.solreffriction = list(own)


def _put_on_rail(mujoco: Any, part: Any, root: Any, X_WB: pin.SE3, rail: Rail) -> None:
    """A slide, a hinge or both, whose inertia is all there is: a cart's weighs, others' does not.

    It sits in the joints (armature), where a slide and a hinge do not act on one another.
    """
    driven = rail.motion is not None
    for body in part.bodies[1:]:  # links fixed to the body weigh nothing beside it
        body.explicitinertial = True
        body.fullinertia = [np.nan] * 6  # not given
        body.mass, body.inertia = 0.0, [0.0] * 3
    cart = not driven and rail.joints == [0]
    root.mass = rail.inertia if cart else _NEXT_TO_NOTHING
    root.inertia = [root.mass] * 3
    for k in rail.joints:
        root.add_joint(
            name=GUIDES[k],
            type=getattr(mujoco.mjtJoint, f"mjJNT_{GUIDES[k].upper()}"),
            pos=X_WB.actInv(rail.through) if k else [0.0] * 3,
            axis=X_WB.rotation.T @ (rail.axis if k else rail.direction),
            armature=DRIVE_MASS if driven else 0.0 if cart else rail.inertia,
            stiffness=0.0 if driven else rail.stiffness,
            damping=0.0 if driven else rail.damping,
        )

"""The MuJoCo model of a rig.

The object hangs on the first arm's gripper, welded or by a joint of the grasp's kind; equality
constraints tie it to the others: a weld, one point (ball) or two points of an axis (hinge). Up to
3.13 MuJoCo's force sensors count the torque of a weld in the axes of its site; three points are
tied there in its place. Only the object and the bodies of the environment touch, with the
collision geometry of their URDFs and soft enough not to chatter. Rotor inertia, damping and
friction of the joints are the chain's.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.environment import Rail
from osc_contact.dynamics.grasp import Grasp
from osc_contact.errors import PlantError
from osc_contact.lab.plants.joint_drives import set_dry_friction
from osc_contact.lab.scenarios.hardware import PlantSpec
from osc_contact.robots import is_mjcf
from osc_contact.robots.mjcf import mjcf_skeleton, placed, weld_joints
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from mujoco import MjSpec

#: The joint between the first arm's tip and the object, if its grasp is a hinge or a ball.
GRASP_JOINT = "object/grasp"
#: Distance of the points that make a hinge, or a weld, from the tip's origin (m).
TIE_SPAN = 0.05

#: Heavy enough that no contact force moves a driven face between two steps (kg, kg m²).
DRIVE_MASS = 1e6
WELDS = 3014000  #: version of MuJoCo from which on sensors feel welds as they are
GUIDES = ("slide", "hinge")  #: joints of a body that moves
_LEAST_INERTIA = 1e-9  # kg, kg m²: MuJoCo needs mass in moving bodies


def scene(
    chain: ClosedChain,
    arm_urdfs: Sequence[Path],
    object_urdf: Path,
    bodies: Sequence[tuple[Path, pin.SE3]],
    options: PlantSpec,
    rails: Sequence[Rail],
) -> MjSpec:
    """The uncompiled specification, see `MujocoPlant`.

    Args:
        chain: model of the arms. arm_urdfs, object_urdf: their files.
        bodies: URDF and pose of each body touched. options: options of the plant.
        rails: how each body moves.
    """
    import mujoco

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False
    spec.option.timestep = options.step
    spec.option.tolerance = 1e-12
    spec.option.iterations = 100
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    off = mujoco.mjtDisableBit
    disabled = off.mjDSBL_AUTORESET | off.mjDSBL_MIDPHASE  # few geometries, all looked at
    if not any(rail.joints for rail in rails):  # all that is constrained hangs together
        disabled |= off.mjDSBL_ISLAND
    spec.option.disableflags = int(disabled)
    for arm, file in zip(chain.arms, arm_urdfs, strict=True):
        frame = spec.worldbody.add_frame(**placed(arm.base))
        spec.attach(_arm(arm, file), prefix=f"{arm.name}/", frame=frame)
        for kind in ("force", "torque") if arm.wrist_sensor is not None else ():
            spec.add_sensor(
                name=f"{arm.name}/{kind}",
                type=getattr(mujoco.mjtSensor, f"mjSENS_{kind.upper()}"),
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                objname=f"{arm.name}/wrist",
            )
    model = chain.model
    for i, name in enumerate(chain.joint_names):
        joint = spec.joint(name)
        joint.armature = model.armature[i]
        joint.damping = np.resize([model.damping[i], 0.0, 0.0], np.shape(joint.damping))
        set_dry_friction(joint, model.upperDryFrictionLimit[i], options.step)
    for actuated in chain.actuated:
        name = chain.joint_names[actuated]
        limit = model.upperEffortLimit[actuated]
        motor = spec.add_actuator(
            name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, ctrlrange=[-limit, limit]
        )
        motor.set_to_motor()
    _hold_object(spec, chain, object_urdf)
    _place_bodies(spec, bodies, rails, options)
    if options.friction > 0.0:
        _add_friction(spec, options)
    return spec


def _place_bodies(
    spec: MjSpec,
    bodies: Sequence[tuple[Path, pin.SE3]],
    rails: Sequence[Rail],
    options: PlantSpec,
) -> None:
    """Attach the bodies of the environment, each on its rail, with their softness and friction.

    Args:
        spec: scene, which is changed.
        bodies: URDF and pose of each body touched.
        rails: how each body moves.
        options: options of the plant.
    """
    for i, ((file, placement), rail) in enumerate(zip(bodies, rails, strict=True)):
        part, root = _read_body(file)
        for geom in part.geoms:
            geom.contype = 1
            geom.conaffinity = 0
            geom.priority = 1
            geom.solref = list(options.solref)
            geom.solimp = [*options.solimp, 0.5, 2.0]
            geom.condim = 1 if options.friction == 0.0 else 3
            geom.friction = [options.friction, 0.0, 0.0]
        if rail.joints:
            _put_on_rail(part, root, placement, rail)
        frame = spec.worldbody.add_frame(**placed(placement))
        spec.attach(part, prefix=f"face{i}/", frame=frame)


def _arm(arm: Arm, file: Path) -> MjSpec:
    """An arm without shapes and losses, locked joints welded, a site where its wrist sensor is."""
    import mujoco

    if is_mjcf(file):
        return mjcf_skeleton(file, arm.tip, arm.wrist_sensor, arm.locked)
    part = mujoco.MjSpec.from_string(_without_shapes(file.read_bytes()))
    part.compiler.fusestatic = False
    weld_joints(part, arm.locked)
    if arm.wrist_sensor is not None:
        part.body(arm.wrist_sensor).add_site(name="wrist")
    return part


@lru_cache(maxsize=32)
def _without_shapes(urdf: bytes) -> str:
    """A robot's URDF without shapes, which may be meshes, and without losses in its joints."""
    root = ElementTree.fromstring(urdf)
    for element in root.iter():
        for tag in ("visual", "collision", "dynamics"):
            for child in element.findall(tag):
                element.remove(child)
    return ElementTree.tostring(root, encoding="unicode")


def _read_body(urdf: Path) -> tuple[Any, Any]:
    """The specification of one body, and its root."""
    import mujoco

    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    root = part.worldbody.first_body()
    root.name = "root"
    return part, root


def _hold_object(spec: MjSpec, chain: ClosedChain, urdf: Path) -> None:
    """The object rides on the first arm; equality constraints tie it to the others."""
    import mujoco

    for arm, grasp in zip(chain.arms, chain.grasps, strict=True):
        if grasp.kind == "other":
            raise PlantError(
                f"arm '{arm.name}': MuJoCo is given rigid, hinge and ball grasps only; "
                "use the rigid plant"
            )
    part, root = _read_body(urdf)
    for geom in part.geoms:
        geom.contype = 0
        geom.conaffinity = 1
    assert chain.payload is not None
    inertia = chain.payload.inertia
    if inertia.mass != root.mass:  # the chain's object is not the one of the file
        I = inertia.inertia  # noqa: E741 - the field's letter
        root.explicitinertial = True
        root.mass = inertia.mass
        root.ipos = inertia.lever
        root.iquat = [1.0, 0.0, 0.0, 0.0]
        root.fullinertia = [*np.diag(I), I[0, 1], I[0, 2], I[1, 2]]
    first = chain.grasps[0]
    if not first.is_rigid:
        root.add_joint(
            name="grasp",
            type=getattr(mujoco.mjtJoint, f"mjJNT_{first.kind.upper()}"),
            pos=first.X_TO.inverse().translation,
            axis=[0, 0, 1] if first.kind == "ball" else first.X_TO.rotation.T @ first.T[3:, 0],
        )
    tips = [spec.body(f"{arm.name}/{arm.tip}") for arm in chain.arms]
    spec.attach(part, prefix="object/", frame=tips[0].add_frame(**placed(first.X_TO)))
    held = spec.body("object/root")
    for arm, tip, grasp in list(zip(chain.arms, tips, chain.grasps, strict=True))[1:]:
        points = _tie_points(grasp)
        poses = [pin.SE3(np.eye(3), point) for point in points] or [grasp.X_TO]
        for k, X in enumerate(poses):
            name = f"{arm.name}/tie.{k}"
            tip.add_site(name=name, **placed(X))
            held.add_site(name=f"object/{name}", **placed(grasp.X_TO.actInv(X)))
            tie = spec.add_equality(
                name=name,
                type=mujoco.mjtEq.mjEQ_CONNECT if points else mujoco.mjtEq.mjEQ_WELD,
                objtype=mujoco.mjtObj.mjOBJ_SITE,
                name1=name,
                name2=f"object/{name}",
                solref=[2 * spec.option.timestep, 1.0],
                solimp=[0.9999, 0.9999, 0.001, 0.5, 2.0],
            )
            if not points:
                tie.data = np.eye(len(tie.data))[10]  # of 11 or 12, by version: its torque scale


def _tie_points(grasp: Grasp) -> list[Array]:
    """Points of the tip frame that stay together in a hinge or a ball; none: a weld."""
    import mujoco

    if grasp.is_rigid:
        return [] if mujoco.mj_version() >= WELDS else list(TIE_SPAN * np.eye(3))
    if grasp.kind == "ball":
        return [np.zeros(3)]
    axis = grasp.T[3:, 0]
    return [TIE_SPAN * axis, -TIE_SPAN * axis]


_IMPEDANCE = 0.03  #: MuJoCo's d of contacts with friction, at `width`
_FRICTION_IMPEDANCE = 0.9  #: d of the friction itself
#: 1/s, of slip: friction is whole from μ f/(9 m · 1000/s) on, and turns back 1 ms before the slip.
_FRICTION_DAMPING = 1e3


def _add_friction(spec: MjSpec, options: PlantSpec) -> None:
    """Coulomb friction between the object's geometries and those of all bodies.

    MuJoCo's cone couples slip and normal force: what slides at v rests higher by μ b v/(d k), d the
    impedance, k and b the reference stiffness and damping. With `solref` and `solimp` as they are
    that is more than the depth of light contacts: they chatter, and are struck where a motion turns
    back. Spring d²k/(1 − d) and damper d b/(1 − d), both for a unit of mass, are as declared here,
    but made by a small d and a large k, and friction has a damping and an impedance apart.
    """
    time, ratio = options.solref
    low, high, width = options.solimp
    most = _IMPEDANCE

    def root(d: float) -> float:
        """Relative natural frequency d/√(1 − d) of a contact's spring for the impedance d."""
        return d / np.sqrt(1.0 - d)

    share = most / root(high)
    power = 1.0
    if low != high:  # of the curve between them, by its middle
        power = -np.log2((root(0.5 * (low + high)) - root(low)) / (root(high) - root(low)))
    fastest = 1.0 / spec.option.timestep  # no damper stops a motion within less than a step
    damping = min(2.0 / time * (1.0 - most) / (1.0 - high), fastest)
    stiffness = (1.0 - most) / ((1.0 - high) * (time * ratio) ** 2)
    friction = _FRICTION_IMPEDANCE / (1.0 - _FRICTION_IMPEDANCE)
    spec.option.impratio = friction * (1.0 - most) / most
    for i, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"geom{i}"
    held = [geom.name for geom in spec.geoms if geom.conaffinity and not geom.contype]
    touched = [geom.name for geom in spec.geoms if geom.contype and not geom.conaffinity]
    for first, second in product(held, touched):
        pair = spec.add_pair(geomname1=first, geomname2=second)
        pair.condim = 3
        pair.friction = [options.friction, options.friction, 0.0, 0.0, 0.0]
        pair.solref = [-stiffness, -damping]
        pair.solimp = [share * root(low), most, width, 1.0, power]
        pair.solreffriction = [-1e-9, -min(_FRICTION_DAMPING, fastest) * most]


def _put_on_rail(part: Any, root: Any, X_WB: pin.SE3, rail: Rail) -> None:
    """A slide, a hinge or both, whose inertia is all there is: a cart's weighs, others' does not.

    It sits in the joints (armature), where a slide and a hinge do not act on one another.
    """
    import mujoco

    driven = rail.motion is not None
    for body in part.bodies[1:]:  # links fixed to the body weigh nothing beside it
        body.explicitinertial = True
        body.fullinertia = [np.nan] * 6  # not given
        body.mass = 0.0
        body.inertia = [0.0] * 3
    cart = not driven and rail.joints == [0]
    root.mass = rail.inertia if cart else _LEAST_INERTIA
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

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
#: Error of the depths of contacts of cylinders, ellipsoids and meshes (m). Light contacts sink in
#: by a micrometre or less; where this is no more than the error, 1 µm in MuJoCo unless it is set,
#: normals may have any direction, and depths may be of millimetres.
DEPTH_TOLERANCE = 1e-10
_LEAST_INERTIA = 1e-9  # kg, kg m²: MuJoCo needs mass in moving bodies


def scene(
    chain: ClosedChain,
    arm_urdfs: Sequence[Path],
    object_urdf: Path,
    bodies: Sequence[tuple[Path, pin.SE3]],
    options: PlantSpec,
    rails: Sequence[Rail],
) -> MjSpec:
    """Make the scene of a `MujocoPlant` as a specification that is not compiled yet.

    Args:
        chain: model of the arms.
        arm_urdfs: file of each arm.
        object_urdf: file of the object.
        bodies: URDF and initial pose of each touched body.
        options: options of the plant.
        rails: rail of each touched body.
    """
    import mujoco

    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.fusestatic = False
    _choose_options(spec, options, rails)
    for arm, file in zip(chain.arms, arm_urdfs, strict=True):
        frame = spec.worldbody.add_frame(**placed(arm.base))
        spec.attach(_arm_specification(arm, file), prefix=f"{arm.name}/", frame=frame)
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


def _choose_options(spec: MjSpec, options: PlantSpec, rails: Sequence[Rail]) -> None:
    """Set the options of MuJoCo's solver and of its collision detection.

    Args:
        spec: specification of the scene, changed.
        options: options of the plant.
        rails: rail of each touched body.
    """
    import mujoco

    spec.option.timestep = options.step
    spec.option.tolerance = 1e-12
    spec.option.iterations = 100
    spec.option.ccd_tolerance = DEPTH_TOLERANCE
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    bits = mujoco.mjtDisableBit
    disabled = bits.mjDSBL_AUTORESET | bits.mjDSBL_MIDPHASE  # few geometries: all are compared
    # more than the deepest contact of two convex bodies, from MuJoCo 4 on, may have the normal of a
    # face where edges touch: tips sink in at their rims
    disabled |= getattr(bits, "mjDSBL_MULTICCD", 0)
    if not any(rail.joints for rail in rails):  # all constrained bodies are connected
        disabled |= bits.mjDSBL_ISLAND
    spec.option.disableflags = int(disabled)


def _place_bodies(
    spec: MjSpec,
    bodies: Sequence[tuple[Path, pin.SE3]],
    rails: Sequence[Rail],
    options: PlantSpec,
) -> None:
    """Attach the bodies of the environment, each on its rail, with their softness and friction.

    Args:
        spec: scene, which is changed.
        bodies: URDF and initial pose of each touched body.
        rails: rail of each body.
        options: options of the plant.
    """
    for i, ((file, placement), rail) in enumerate(zip(bodies, rails, strict=True)):
        part, root = _read_body(file)
        for geom in part.geoms:
            # touches the object (contype & conaffinity), with its own softness and friction
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


def _arm_specification(arm: Arm, file: Path) -> MjSpec:
    """Make the specification of an arm: locked joints welded, a site at its wrist sensor.

    Shapes and losses are left out; losses are set from the chain.

    Args:
        arm: model of the arm.
        file: URDF or MJCF file.
    """
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
    """Remove shapes, which may be meshes, and losses of joints from the text of a URDF.

    Args:
        urdf: text of the URDF.
    """
    root = ElementTree.fromstring(urdf)
    for element in root.iter():
        for tag in ("visual", "collision", "dynamics"):
            for child in element.findall(tag):
                element.remove(child)
    return ElementTree.tostring(root, encoding="unicode")


def _read_body(urdf: Path) -> tuple[Any, Any]:
    """Read the URDF of one body; return its specification and its root, which is named "root".

    Args:
        urdf: path of the body's URDF.
    """
    import mujoco

    part = mujoco.MjSpec.from_file(str(urdf))
    part.compiler.fusestatic = False
    root = part.worldbody.first_body()
    root.name = "root"
    return part, root


def _hold_object(spec: MjSpec, chain: ClosedChain, urdf: Path) -> None:
    """Attach the object to the first arm, and tie it to the others by equality constraints.

    Args:
        spec: scene with the arms, changed.
        chain: model of arms, grasps and object.
        urdf: file of the object.

    Raises:
        PlantError: a grasp is neither rigid, a hinge nor a ball.
    """
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
    if inertia.mass != root.mass:  # the mass of the chain's object differs from that of the file
        I = inertia.inertia  # noqa: E741 - the field's letter
        root.explicitinertial = True
        root.mass = inertia.mass
        root.ipos = inertia.lever
        root.iquat = [1.0, 0.0, 0.0, 0.0]
        root.fullinertia = [*np.diag(I), I[0, 1], I[0, 2], I[1, 2]]
    first = chain.grasps[0]
    if not first.is_rigid:
        _add_grasp_joint(root, first)
    tips = [spec.body(f"{arm.name}/{arm.tip}") for arm in chain.arms]
    spec.attach(part, prefix="object/", frame=tips[0].add_frame(**placed(first.X_TO)))
    further = zip(chain.arms[1:], tips[1:], chain.grasps[1:], strict=True)
    for arm, tip, grasp in further:
        _tie_object(spec, arm.name, tip, grasp)


def _add_grasp_joint(root: Any, grasp: Grasp) -> None:
    """Add the joint of a hinge or a ball between the object and the tip of the first arm.

    Args:
        root: root of the object's specification, changed.
        grasp: grasp of the first arm.
    """
    import mujoco

    root.add_joint(
        name="grasp",
        type=getattr(mujoco.mjtJoint, f"mjJNT_{grasp.kind.upper()}"),
        pos=grasp.X_TO.inverse().translation,
        axis=[0, 0, 1] if grasp.kind == "ball" else grasp.X_TO.rotation.T @ grasp.T[3:, 0],
    )


def _tie_object(spec: MjSpec, arm: str, tip: Any, grasp: Grasp) -> None:
    """Tie the object to the tip of a further arm by equality constraints.

    Args:
        spec: scene with arms and object, changed.
        arm: name of the arm.
        tip: body of its tip.
        grasp: grasp of the arm.
    """
    import mujoco

    object_body = spec.body("object/root")
    points = _tie_points(grasp)
    poses = [pin.SE3(np.eye(3), point) for point in points] or [grasp.X_TO]
    for k, X in enumerate(poses):
        name = f"{arm}/tie.{k}"
        tip.add_site(name=name, **placed(X))
        object_body.add_site(name=f"object/{name}", **placed(grasp.X_TO.actInv(X)))
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
            # a weld has 11 or 12 numbers, by version; number 10 is its torque scale
            tie.data = np.eye(len(tie.data))[10]


def _tie_points(grasp: Grasp) -> list[Array]:
    """Points (3,) in the tip frame that are tied to the object (m); none: a weld ties both.

    Args:
        grasp: grasp of a further arm.
    """
    import mujoco

    if grasp.is_rigid:
        return [] if mujoco.mj_version() >= WELDS else list(TIE_SPAN * np.eye(3))
    if grasp.kind == "ball":
        return [np.zeros(3)]
    axis = grasp.T[3:, 0]
    return [TIE_SPAN * axis, -TIE_SPAN * axis]


_CONTACT_IMPEDANCE = 0.03  #: MuJoCo's d of contacts with friction, at `width`
_FRICTION_IMPEDANCE = 0.9  #: MuJoCo's d of the friction constraint
#: Damping of slip (1/s): friction is fully developed at a slip of μ f/(9 m · 1000/s), and changes
#: its sign 1 ms before the slip does.
_FRICTION_DAMPING = 1e3


def _add_friction(spec: MjSpec, options: PlantSpec) -> None:
    """Add Coulomb friction between the object's geometries and those of all touched bodies.

    MuJoCo's cone couples slip and normal force: an object that slides at v is raised by
    μ b v/(d k), where d is the impedance, k and b the reference stiffness and damping. With the
    scenario's `solref` and `solimp` this is more than the depth of light contacts, which would
    chatter, and be hit when a motion reverses. Therefore the same spring d²k/(1 − d) and damper
    d b/(1 − d), for a unit of mass, are made with a small d and a large k, and friction has a
    damping and an impedance of its own.

    Args:
        spec: scene with object and bodies, changed.
        options: options of the plant.
    """
    time, ratio = options.solref
    low, high, width = options.solimp
    largest_impedance = _CONTACT_IMPEDANCE

    def root(d: float) -> float:
        """Relative natural frequency d/√(1 − d) of a contact's spring for the impedance d."""
        return d / np.sqrt(1.0 - d)

    share = largest_impedance / root(high)
    power = 1.0  # exponent of the curve of impedances, fitted in its middle
    if low != high:
        power = -np.log2((root(0.5 * (low + high)) - root(low)) / (root(high) - root(low)))
    fastest = 1.0 / spec.option.timestep  # no damper stops a motion within less than a step
    damping = min(2.0 / time * (1.0 - largest_impedance) / (1.0 - high), fastest)
    stiffness = (1.0 - largest_impedance) / ((1.0 - high) * (time * ratio) ** 2)
    friction = _FRICTION_IMPEDANCE / (1.0 - _FRICTION_IMPEDANCE)
    spec.option.impratio = friction * (1.0 - largest_impedance) / largest_impedance
    for i, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"geom{i}"
    own_geoms = [geom.name for geom in spec.geoms if geom.conaffinity and not geom.contype]
    touched_geoms = [geom.name for geom in spec.geoms if geom.contype and not geom.conaffinity]
    for first, second in product(own_geoms, touched_geoms):
        pair = spec.add_pair(geomname1=first, geomname2=second)
        pair.condim = 3
        pair.friction = [options.friction, options.friction, 0.0, 0.0, 0.0]
        pair.solref = [-stiffness, -damping]
        pair.solimp = [share * root(low), largest_impedance, width, 1.0, power]
        pair.solreffriction = [-1e-9, -min(_FRICTION_DAMPING, fastest) * largest_impedance]


def _put_on_rail(part: Any, root: Any, X_WB: pin.SE3, rail: Rail) -> None:
    """Add the joints of a rail to a body: a slide, a hinge or both.

    The inertia of the body is replaced by that of the rail. Only a cart has a mass and therefore a
    weight; other inertias are armatures of the joints, which do not couple slide and hinge.

    Args:
        part: specification of the body, changed.
        root: its root.
        X_WB: initial pose of the body.
        rail: rail of the body.
    """
    import mujoco

    driven = rail.motion is not None
    for body in part.bodies[1:]:  # further links of the body get no mass
        body.explicitinertial = True
        body.fullinertia = [np.nan] * 6  # NaN: not used
        body.mass = 0.0
        body.inertia = [0.0] * 3
    is_cart = not driven and rail.joints == [0]
    root.mass = rail.inertia if is_cart else _LEAST_INERTIA
    root.inertia = [root.mass] * 3
    if driven:
        armature = DRIVE_MASS
    elif is_cart:
        armature = 0.0
    else:
        armature = rail.inertia
    for k in rail.joints:
        is_hinge = GUIDES[k] == "hinge"
        root.add_joint(
            name=GUIDES[k],
            type=getattr(mujoco.mjtJoint, f"mjJNT_{GUIDES[k].upper()}"),
            pos=X_WB.actInv(rail.through) if is_hinge else [0.0] * 3,
            axis=X_WB.rotation.T @ (rail.axis if is_hinge else rail.direction),
            armature=armature,
            stiffness=0.0 if driven else rail.stiffness,
            damping=0.0 if driven else rail.damping,
        )

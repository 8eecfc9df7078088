"""The Drake model of a rig.

The object is welded to the arm that leads it; constraints tie it to the others: a weld, one point
(ball) or two points of an axis (hinge). Only the object and the bodies of the environment touch,
with the collision geometry of their URDFs. A pair of several forces, such as a face on a face, gets
a hydroelastic contact, as Drake's point contacts give one point for each pair of shapes. Rotor
inertia and damping of the joints are the chain's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.contacts.pairs.pair import count_forces
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.dynamics.grasp import Grasp
from osc_contact.errors import PlantError
from osc_contact.lab.scenarios.hardware import PlantSpec
from osc_contact.robots import is_mjcf
from osc_contact.spatial import Array

#: Distance of the points that make a hinge from the tip's origin (m).
TIE_SPAN = 0.05
_RESOLUTION = 0.05  #: length of the edges of hydroelastic meshes (m)
#: Joint types of URDF whose axis is one of translation; all others turn.
_SLIDING = "prismatic"


@dataclass(frozen=True)
class DrakeScene:
    """Parts of the Drake model of a rig.

    Attributes:
        diagram: Drake's diagram of plant and geometry.
        plant: Drake's "MultibodyPlant".
        joints: Drake's joint of each joint of the chain.
        held: Drake's body of the object.
        tips: Drake's body of each arm's tip.
        faces: index of the environment's body by Drake's number of each of its shapes.
        cuts: for each arm the place of its wrist in Drake's list of reactions; None: no sensor.
    """

    diagram: Any
    plant: Any
    joints: tuple[Any, ...]
    held: Any
    tips: tuple[Any, ...]
    faces: Mapping[int, int]
    cuts: tuple[int | None, ...]


def scene(
    chain: ClosedChain,
    arm_urdfs: Sequence[Path],
    object_urdf: Path,
    contacts: Sequence[ContactPair],
    bodies: Sequence[tuple[Path, pin.SE3]],
    on: Sequence[int],
    options: PlantSpec,
) -> DrakeScene:
    """Make the scene of a `DrakePlant`.

    Args:
        chain: model of the arms.
        arm_urdfs: file of each arm.
        object_urdf: file of the object.
        contacts: contact pairs.
        bodies: URDF and pose of each touched body.
        on: index of the body of each contact.
        options: options of the plant.

    Raises:
        PlantError: the scene has a part that this plant does not model; the message names it.
    """
    from pydrake.multibody.plant import AddMultibodyPlant, MultibodyPlantConfig
    from pydrake.systems.framework import DiagramBuilder

    has_areas = {i for i, pair in zip(on, contacts, strict=True) if count_forces(pair) > 1}
    builder = DiagramBuilder()
    config = MultibodyPlantConfig(
        time_step=options.step,
        discrete_contact_approximation=options.drake.contact,
        contact_model="hydroelastic_with_fallback" if has_areas else "point",
        stiction_tolerance=options.drake.stiction,
        use_sampled_output_ports=False,  # readings under the present torques
    )
    plant, geometry = AddMultibodyPlant(config, builder)
    models = [_add_arm(plant, *pair) for pair in zip(chain.arms, arm_urdfs, strict=True)]
    joints = []
    for name in chain.joint_names:
        arm, joint = name.split("/", 1)
        index = [one.name for one in chain.arms].index(arm)
        joints.append(plant.GetJointByName(joint, models[index]))
    _add_motors(plant, chain, joints)
    held = _add_body(plant, "object", _object_text(chain, object_urdf))
    tips = [plant.GetBodyByName(a.tip, m) for a, m in zip(chain.arms, models, strict=True)]
    _hold_object(plant, chain, tips, held)
    faces: dict[int, int] = {}
    _set_material(plant, geometry, held, options, is_soft=bool(has_areas), is_held=True)
    for i, (file, placement) in enumerate(bodies):
        face = _add_body(plant, f"face{i}", ElementTree.parse(file).getroot())
        plant.WeldFrames(plant.world_frame(), face.body_frame(), _drake_transform(placement))
        _set_material(plant, geometry, face, options, is_soft=i in has_areas, is_held=False)
        faces |= {shape.get_value(): i for shape in plant.GetCollisionGeometriesForBody(face)}
    plant.Finalize()
    cuts = [_wrist_reaction(plant, a, m) for a, m in zip(chain.arms, models, strict=True)]
    return DrakeScene(builder.Build(), plant, tuple(joints), held, tuple(tips), faces, tuple(cuts))


def _drake_transform(X: pin.SE3) -> Any:
    """Convert a pose to Drake's "RigidTransform"."""
    from pydrake.math import RigidTransform, RotationMatrix

    return RigidTransform(RotationMatrix.ProjectToRotationMatrix(X.rotation), X.translation)


def _add_model(plant: Any, text: Element, name: str) -> Any:
    """Add a model from a URDF, and return Drake's index of it.

    Args:
        plant: Drake's plant, changed.
        text: root of the URDF, changed.
        name: name of the model.
    """
    from pydrake.multibody.parsing import Parser

    text.set("name", name)
    parser = Parser(plant)
    (model,) = parser.AddModelsFromString(ElementTree.tostring(text, encoding="unicode"), "urdf")
    return model


def _root_link(text: Element) -> str:
    """Name of the link of a URDF that is no child of a joint.

    Args:
        text: root element of the URDF.
    """
    children = {child.get("link") for child in text.iter("child")}
    (root,) = (
        link.get("name", "") for link in text.findall("link") if link.get("name") not in children
    )
    return root


# --- Arms -----------------------------------------------------------------------------------------


def _add_arm(plant: Any, arm: Arm, file: Path) -> Any:
    """Add an arm without shapes, its locked joints fixed, at its base; return Drake's index of it.

    Args:
        plant: Drake's plant, changed.
        arm: model of the arm.
        file: its URDF.

    Raises:
        PlantError: the file is MJCF.
    """
    if is_mjcf(file):
        raise PlantError(
            f"arm '{arm.name}': the drake plant reads URDFs, and {file.name} is MJCF; use "
            "plant.type mujoco"
        )
    # Drake gets shapes only of bodies that touch, and losses of joints and drives by `_add_motors`;
    # it refuses or misreads some of the other elements
    text = ElementTree.parse(file).getroot()
    unused = ("visual", "collision", "dynamics", "mimic", "safety_controller", "calibration")
    for element in text.iter():
        for tag in unused:
            for child in element.findall(tag):
                element.remove(child)
    for tag in ("transmission", "gazebo"):
        for child in text.findall(tag):
            text.remove(child)
    for element in text.iter():  # Drake takes a link of this name for its own world
        for key in ("name", "link"):
            if element.tag in ("link", "parent") and element.get(key) == "world":
                element.set(key, "world_of_arm")
    for joint in text.findall("joint"):
        if joint.get("name") in arm.locked:
            _fix_joint(joint, arm.locked[joint.get("name", "")])
    root = _root_link(text)
    model = _add_model(plant, text, arm.name)
    plant.WeldFrames(
        plant.world_frame(), plant.GetFrameByName(root, model), _drake_transform(arm.base)
    )
    return model


def _fix_joint(joint: Element, position: float) -> None:
    """Replace a joint of a URDF by a fixed one at a position.

    The pose X of the fixed joint is the origin of the joint, followed by a translation along its
    axis (sliding) or a rotation about it. Axis and limits are removed, as fixed joints have none.

    Args:
        joint: element, changed.
        position: position of the joint (m, rad).
    """

    def vector(tag: str, key: str, default: str) -> Array:
        """Read three numbers of the first child `tag` of the joint: its attribute `key`.

        Args:
            tag: name of the child element.
            key: name of the attribute.
            default: text of the numbers if child or attribute is missing.
        """
        child = joint.find(tag)
        return np.array((default if child is None else child.get(key, default)).split(), float)

    axis = vector("axis", "xyz", "1 0 0")
    axis = axis / np.linalg.norm(axis) if joint.get("type") != "fixed" else axis
    X = pin.SE3(
        pin.rpy.rpyToMatrix(vector("origin", "rpy", "0 0 0")), vector("origin", "xyz", "0 0 0")
    )
    if joint.get("type") == _SLIDING:
        X = X * pin.SE3(np.eye(3), position * axis)
    elif joint.get("type") != "fixed":
        X = X * pin.SE3(pin.exp3(position * axis), np.zeros(3))
    joint.set("type", "fixed")
    for tag in ("origin", "axis", "limit"):
        for child in joint.findall(tag):
            joint.remove(child)
    ElementTree.SubElement(
        joint,
        "origin",
        xyz=_exact_text(X.translation),
        rpy=_exact_text(pin.rpy.matrixToRpy(X.rotation)),
    )


def _exact_text(numbers: Sequence[float] | Array) -> str:
    """Numbers as words of a URDF, without loss."""
    return " ".join(repr(float(x)) for x in numbers)


def _add_motors(plant: Any, chain: ClosedChain, joints: Sequence[Any]) -> None:
    """Add the motors, in the order of the chain's torques, and damping of the joints.

    Args:
        plant: Drake's plant, changed.
        chain: model of the arms.
        joints: Drake's joints.

    Raises:
        PlantError: a joint has dry friction, or a passive joint a rotor.
    """
    model = chain.model
    for name, joint, damping, friction in zip(
        chain.joint_names, joints, model.damping, model.upperDryFrictionLimit, strict=True
    ):
        joint.set_default_damping(float(damping))
        if friction > 0.0:
            raise PlantError(
                f"arms.friction: joint {name} has a dry friction of {friction:.3g}, which the "
                "drake plant does not model; set it to [0], or use plant.type mujoco"
            )
    rotors_without_motor = np.delete(model.armature, chain.actuated)
    if rotors_without_motor.any():
        raise PlantError(
            "arms.armature: a joint without a motor has a rotor inertia, which the drake plant "
            "does not model; set it to 0, or use plant.type mujoco"
        )
    for i in chain.actuated.tolist():
        limit = float(model.upperEffortLimit[i])
        motor = plant.AddJointActuator(chain.joint_names[i].replace("/", "_"), joints[i], limit)
        motor.set_default_rotor_inertia(float(model.armature[i]))
        motor.set_default_gear_ratio(1.0)


def _wrist_reaction(plant: Any, arm: Arm, model: Any) -> int | None:
    """Place of an arm's wrist in Drake's list of reactions; None: the arm has no sensor.

    Args:
        plant: Drake's plant, finalized.
        arm: model of the arm.
        model: Drake's index of it.

    Raises:
        PlantError: the sensor is not on a link that a fixed joint carries.
    """
    if arm.wrist_sensor is None:
        return None
    for place, index in enumerate(plant.GetJointIndices()):
        joint = plant.get_joint(index)
        is_carried = joint.child_body().name() == arm.wrist_sensor
        if is_carried and joint.model_instance() == model:
            if joint.type_name() == "weld":
                return place
            break
    raise PlantError(
        f"arm '{arm.name}': the drake plant reads wrists at fixed joints, and wrist_sensor "
        f"{arm.wrist_sensor} is not carried by one; use plant.type mujoco"
    )


# --- Object and environment -----------------------------------------------------------------------


def _add_body(plant: Any, name: str, text: Element) -> Any:
    """Add a body of one link without its pictures; return it.

    Args:
        plant: Drake's plant, changed.
        name: name of the body.
        text: root of its URDF, changed.

    Raises:
        PlantError: the URDF has several links.
    """
    if len(text.findall("link")) != 1:
        raise PlantError(
            f"{text.get('name')}: the drake plant takes objects and touched bodies of one link, "
            f"and this has {len(text.findall('link'))}; use plant.type mujoco"
        )
    for link in text.findall("link"):
        for child in link.findall("visual"):
            link.remove(child)
    link_name = _root_link(text)
    return plant.GetBodyByName(link_name, _add_model(plant, text, name))


def _object_text(chain: ClosedChain, file: Path) -> Element:
    """Root of the object's URDF, with the mass and inertia of the chain's object.

    The model of the object may have another mass than its file, such as a hidden one. The six
    moments are those of a symmetric matrix, ixx to izz, about the centre of mass.

    Args:
        chain: model of arms and object.
        file: URDF of the object.
    """
    text = ElementTree.parse(file).getroot()
    assert chain.payload is not None
    inertia = chain.payload.inertia
    for link in text.findall("link"):
        for child in link.findall("inertial"):
            link.remove(child)
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "origin", xyz=_exact_text(inertia.lever), rpy="0 0 0")
        ElementTree.SubElement(inertial, "mass", value=_exact_text([inertia.mass]))
        axes = "xyz"
        moments = {
            f"i{axes[i]}{axes[j]}": _exact_text([inertia.inertia[i, j]])
            for i in range(3)
            for j in range(i, 3)
        }
        ElementTree.SubElement(inertial, "inertia", moments)
    return text


def _hold_object(plant: Any, chain: ClosedChain, tips: Sequence[Any], held: Any) -> None:
    """Weld the object to the tip that leads it, and tie it to the others by constraints.

    Args:
        plant: Drake's plant, changed.
        chain: arms and grasps.
        tips: Drake's bodies of the tips.
        held: Drake's body of the object.

    Raises:
        PlantError: no arm holds the object rigidly, or a grasp is neither rigid, hinge nor ball.
    """
    if chain.leader is None:
        raise PlantError(
            "grasps: no arm holds the object rigidly, and the drake plant welds it to one; use "
            "plant.type mujoco"
        )
    for i, (arm, grasp, tip) in enumerate(zip(chain.arms, chain.grasps, tips, strict=True)):
        X_TO = _drake_transform(grasp.X_TO)
        if i == chain.leader:
            plant.WeldFrames(tip.body_frame(), held.body_frame(), X_TO)
        elif grasp.is_rigid:
            plant.AddWeldConstraint(tip, X_TO, held, _drake_transform(pin.SE3.Identity()))
        else:
            for point in _tie_points(arm.name, grasp):
                plant.AddBallConstraint(tip, point, held, grasp.X_TO.actInv(point))


def _tie_points(arm: str, grasp: Grasp) -> list[Array]:
    """Points (3,) in the tip frame of a hinge or ball that are tied to the object (m).

    Args:
        arm: name of the arm.
        grasp: its grasp.

    Raises:
        PlantError: the grasp is of another kind.
    """
    if grasp.kind == "ball":
        return [np.zeros(3)]
    if grasp.kind == "hinge":
        axis = grasp.T[3:, 0]
        return [TIE_SPAN * axis, -TIE_SPAN * axis]
    raise PlantError(
        f"arm '{arm}': the drake plant is given rigid, hinge and ball grasps only; use the rigid "
        "plant"
    )


def _set_material(
    plant: Any, geometry: Any, body: Any, options: PlantSpec, *, is_soft: bool, is_held: bool
) -> None:
    """Set stiffness, dissipation and friction of the shapes of a body.

    Two shapes of equal stiffness 2k make a contact of stiffness k. A hydroelastic contact of the
    object's box, soft on a rigid face, has the pressure E x/h at depth x, where h is half the box's
    thickness: with E = k h/A the area A has the stiffness k.

    Args:
        plant: Drake's plant.
        geometry: Drake's scene graph, changed.
        body: Drake's body.
        options: options of the plant.
        is_soft: whether its contacts are hydroelastic.
        is_held: whether the body is the object.

    Raises:
        PlantError: a hydroelastic shape of the object is no box.
    """
    from pydrake.geometry import (
        AddCompliantHydroelasticProperties,
        AddContactMaterial,
        AddRigidHydroelasticProperties,
        Box,
        ProximityProperties,
        RoleAssign,
    )
    from pydrake.multibody.plant import CoulombFriction

    spec = options.drake
    inspector = geometry.model_inspector()
    for shape_id in plant.GetCollisionGeometriesForBody(body):
        properties = ProximityProperties()
        if is_soft and is_held:
            shape = inspector.GetShape(shape_id)
            if not isinstance(shape, Box):
                raise PlantError(
                    f"{inspector.GetName(shape_id)}: a contact of several forces needs a box on "
                    "the object in the drake plant; use plant.type mujoco"
                )
            # E = k h/A: h is half the smallest side, A the area of the two others
            thickness, *sides = sorted(shape.size())
            modulus = spec.area_stiffness * 0.5 * thickness / (sides[0] * sides[1])
            AddCompliantHydroelasticProperties(_RESOLUTION, modulus, properties)
        elif is_soft:
            AddRigidHydroelasticProperties(_RESOLUTION, properties)
        # twice the stiffness, since the two shapes of a contact are springs in series
        AddContactMaterial(
            dissipation=spec.dissipation,
            point_stiffness=2.0 * spec.stiffness,
            friction=CoulombFriction(options.friction, options.friction),
            properties=properties,
        )
        properties.AddProperty("material", "relaxation_time", spec.relaxation)
        geometry.AssignRole(plant.get_source_id(), shape_id, properties, RoleAssign.kReplace)

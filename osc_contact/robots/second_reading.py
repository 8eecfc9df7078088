"""Comparison of this package's reading of a URDF with that of yourdfpy.

Readers of URDFs interpret unusual files in different ways. If two readers without common code agree
on joints, placements, inertias and meshes, an error of reading is unlikely.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from osc_contact.errors import ModelError, missing
from osc_contact.robots.checks import Inertias, JointLimits, matching_limits
from osc_contact.robots.elements import Element
from osc_contact.robots.loading import load
from osc_contact.robots.model import frame_id, joint_names, position_limits, random_configurations
from osc_contact.robots.urdf import LIMITS, Document
from osc_contact.spatial import Array, norm

if TYPE_CHECKING:
    from yourdfpy import URDF
    from yourdfpy import Inertial as TheirInertial
    from yourdfpy import Mesh as TheirMesh

TOLERANCE = 1e-9  #: largest absolute plus relative difference of numbers that count as equal
AGREE = "yourdfpy reads the same joints, placements, inertias and meshes"


def differences(
    path: Path | str,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    inertias: Inertias = "possible",
    package_dirs: Sequence[Path | str] = (),
) -> list[str]:
    """Compare yourdfpy's reading of a URDF with that of `load_model`; return sentences.

    Compared are the names, parents and children of joints, their limits, the placements of links
    in two postures, masses, centres and moments of inertia of the bodies that move, and the
    addresses and scales of meshes. Limits by hand are not compared.

    Args:
        path, limits, inertias, package_dirs: see `load_model`.

    Raises:
        ModelError: the file is refused, see `load_model`; or yourdfpy is not installed.
    """
    try:
        import yourdfpy
    except ImportError as error:
        raise ModelError(missing(error)) from error
    model, document = load(path, limits=limits, inertias=inertias, package_dirs=package_dirs)
    try:
        other = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        return [f"yourdfpy does not read the file: {error}"]
    by_hand = matching_limits(joint_names(model), dict(limits or {}))
    sentences = list(_tree_differences(document, other))
    if not sentences:  # otherwise links and joints may have no counterparts
        sentences += _limit_differences(model, document, other, by_hand)
        sentences += _placement_differences(model, document, other)
        sentences += _inertia_differences(model, other)
        sentences += _mesh_differences(document, other)
    return sentences


def _are_equal(ours: ArrayLike, theirs: ArrayLike) -> bool:
    """True if two numbers, or two arrays of numbers, are equal up to `TOLERANCE`.

    Args:
        ours: numbers by this package's reader of URDFs.
        theirs: numbers by the other reader, of the same shape.
    """
    return bool(np.allclose(ours, theirs, rtol=TOLERANCE, atol=TOLERANCE))


def _tree_differences(document: Document, other: URDF) -> Iterator[str]:
    """Yield differences of the names of links and joints, and of joints' type, links and master.

    Args:
        document: reading of this package.
        other: reading of yourdfpy.
    """
    for kind, ours, theirs in (
        ("link", {*document.links}, {*other.link_map}),
        ("joint", {*document.joints}, {*other.joint_map}),
    ):
        for name in sorted(ours - theirs):
            yield f"{kind} '{name}' is read by osc_contact only"
        for name in sorted(theirs - ours):
            yield f"{kind} '{name}' is read by yourdfpy only"
    for name in sorted({*document.joints} & {*other.joint_map}):
        joint = document.joints[name]
        other_joint = other.joint_map[name]
        master = None if other_joint.mimic is None else other_joint.mimic.joint
        for quantity, our_value, their_value in (
            ("type", joint.kind, other_joint.type),
            ("parent", joint.parent, other_joint.parent),
            ("child", joint.child, other_joint.child),
            ("master", joint.mimic, master),
        ):
            if our_value != their_value:
                yield (
                    f"joint '{name}': its {quantity} is {our_value!r}, by yourdfpy {their_value!r}"
                )


def _limit_differences(
    model: pin.Model,
    document: Document,
    other: URDF,
    by_hand: Mapping[str, Mapping[str, float]],
) -> Iterator[str]:
    """Yield differences of the limits of moving joints that have a <limit> in the file.

    Args:
        model: model by the reading of this package.
        document: reading of this package.
        other: reading of yourdfpy.
        by_hand: limits that replace those of the file, by joint; such joints are not compared.
    """
    lower, upper = position_limits(model)
    effort = model.upperEffortLimit
    velocity = model.upperVelocityLimit
    for j, name in enumerate(joint_names(model)):
        theirs = other.joint_map[name].limit
        if name in by_hand or theirs is None:
            continue
        ours = dict(zip(LIMITS, (lower[j], upper[j], effort[j], velocity[j]), strict=True))
        if document.joints[name].kind == "continuous":  # position limits in the file are ignored
            del ours["lower"], ours["upper"]
        for key, our_limit in ours.items():
            their_limit = getattr(theirs, key)
            if their_limit is not None and not _are_equal(our_limit, their_limit):
                yield f"joint '{name}': {key} {our_limit:.9g}, by yourdfpy {their_limit:.9g}"


def _placement_differences(model: pin.Model, document: Document, other: URDF) -> Iterator[str]:
    """Yield differences of the pose of each joint's child link in its parent link.

    Poses are compared at the neutral configuration and at a random one.

    Args:
        model: model by the reading of this package.
        document: reading of this package.
        other: reading of yourdfpy.
    """
    for q in (pin.neutral(model), *random_configurations(model, 1)):
        ours, theirs = _link_poses(model, other, q)
        for name, joint in document.joints.items():
            our_pose = ours[joint.parent].actInv(ours[joint.child])
            their_pose = theirs[joint.parent].actInv(theirs[joint.child])
            if not _are_equal(our_pose.homogeneous, their_pose.homogeneous):
                X = our_pose.actInv(their_pose)
                yield (
                    f"joint '{name}': yourdfpy places its child {norm(X.translation):.3g} m "
                    f"and {norm(pin.log3(X.rotation)):.3g} rad elsewhere, in the posture "
                    f"{np.array2string(q, precision=3)}"
                )


def _link_poses(
    model: pin.Model, other: URDF, q: Array
) -> tuple[dict[str, pin.SE3], dict[str, pin.SE3]]:
    """Compute the poses of all links in the world by name, by this package and by yourdfpy.

    Args:
        model: model by the reading of this package.
        other: reading of yourdfpy.
        q: (n,) joint positions; those of joints with a master are computed from the master's.
    """
    position = dict(zip(joint_names(model), q.tolist(), strict=True))
    for name in position:
        mimic = other.joint_map[name].mimic
        if mimic is not None:
            position[name] = mimic.multiplier * position[mimic.joint] + mimic.offset
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(list(position.values())))
    if position:
        other.update_cfg({name: position[name] for name in other.actuated_joint_names})
    names = list(other.link_map)
    ours = {name: data.oMf[frame_id(model, name)] for name in names}
    theirs = {name: pin.SE3(other.get_transform(name, other.base_link)) for name in names}
    return (ours, theirs)


def _inertia_differences(model: pin.Model, other: URDF) -> Iterator[str]:
    """Yield differences of mass, first moment and moments of inertia of each moving body.

    A moving body consists of the links that fixed joints connect.

    Args:
        model: model by the reading of this package.
        other: reading of yourdfpy.
    """
    bodies = [np.zeros((6, 6)) for _ in model.inertias]
    for name, link in other.link_map.items():
        frame = model.frames[frame_id(model, name)]
        if link.inertial is not None:
            bodies[frame.parentJoint] += _spatial_inertia(link.inertial, frame.placement)
    for j, theirs in enumerate(bodies):
        ours = model.inertias[j].matrix()
        body = f"the body behind joint '{model.names[j]}'" if j else "the base"
        for part, unit, block in (
            ("mass", "kg", np.s_[:3, :3]),
            ("first moment of mass", "kg m", np.s_[3:, :3]),
            ("moments of inertia", "kg m²", np.s_[3:, 3:]),
        ):
            if not _are_equal(ours[block], theirs[block]):
                difference = np.abs(ours[block] - theirs[block]).max()
                yield f"{body}: its {part} differs from yourdfpy's by {difference:.3g} {unit}"


def _spatial_inertia(inertial: TheirInertial, X_JL: pin.SE3) -> Array:
    """Spatial inertia (6, 6) of a link in the frame of its joint, linear part first.

    Args:
        inertial: inertia of the link as read by yourdfpy.
        X_JL: pose of the link in the frame of its joint.
    """
    X_LC = pin.SE3.Identity() if inertial.origin is None else pin.SE3(inertial.origin)
    I_C = np.zeros((6, 6))
    I_C[:3, :3] = (inertial.mass or 0.0) * np.eye(3)
    I_C[3:, 3:] = np.zeros((3, 3)) if inertial.inertia is None else inertial.inertia
    X = X_JL * X_LC
    return np.asarray(X.toDualActionMatrix() @ I_C @ X.inverse().toActionMatrix())


def _mesh_differences(document: Document, other: URDF) -> Iterator[str]:
    """Yield differences of the addresses and scales of the meshes of each link.

    Args:
        document: reading of this package.
        other: reading of yourdfpy.
    """
    for name, link in document.links.items():
        other_link = other.link_map[name]
        for tag, shapes in (("visual", other_link.visuals), ("collision", other_link.collisions)):
            theirs = [_their_mesh(shape.geometry.mesh) for shape in shapes if shape.geometry.mesh]
            ours = [
                _our_mesh(mesh)
                for shape in link.element.findall(tag)
                for mesh in shape.iter("mesh")
            ]
            our_addresses = [address for address, _ in ours]
            their_addresses = [address for address, _ in theirs]
            if our_addresses != their_addresses:
                yield f"link '{name}': {tag} meshes {our_addresses}, by yourdfpy {their_addresses}"
            elif not all(_are_equal(a, b) for (_, a), (_, b) in zip(ours, theirs, strict=True)):
                yield f"link '{name}': yourdfpy scales {tag} meshes in another way"


def _our_mesh(mesh: Element) -> tuple[str, Array]:
    """Address and scale (3,) of a mesh by the reading of this package."""
    return (mesh.get("filename"), np.array(mesh.vector("scale", (1.0, 1.0, 1.0))))


def _their_mesh(mesh: TheirMesh) -> tuple[str, Array]:
    """Address and scale (3,) of a mesh by the reading of yourdfpy."""
    scale = 1.0 if mesh.scale is None else mesh.scale
    return (mesh.filename, np.broadcast_to(scale, 3))

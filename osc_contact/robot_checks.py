"""What a URDF must satisfy before a controller may trust it: one check, one duty.

:func:`osc_contact.robots.load_model` runs them in order; each raises
:class:`~osc_contact.errors.ModelError` with the file, the joint or link, the numbers and the cure.
"""

from __future__ import annotations

import difflib
import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin

from osc_contact.errors import ModelError
from osc_contact.spatial import Array

__all__ = [
    "read_urdf",
    "check_limits",
    "check_inertia",
    "check_joints",
    "check_mass_matrix",
    "link_mass",
    "frame_id",
    "placement_difference",
    "random_configurations",
    "suggest",
]

_CROSS_CHECK_SAMPLES = 5
_TRIANGLE_SLACK = 1e-6
"""Relative slack of the triangle inequality: the digits a URDF usually carries."""
_DIAGONAL_FLOOR, _EIGENVALUE_FLOOR = 1e-13, 1e-11
"""The mass matrix is singular below: diagonal / largest one, eigenvalue at unit diagonal."""


def read_urdf(file: Path) -> tuple[list[ElementTree.Element], list[ElementTree.Element]]:
    """(links, joints) of a URDF file as XML elements."""
    if not file.is_file():
        raise ModelError(f"{file}: {'is not a file' if file.exists() else 'does not exist'}")
    try:
        root = ElementTree.parse(file).getroot()
    except (ElementTree.ParseError, UnicodeDecodeError) as error:
        raise ModelError(f"{file}: not well-formed XML: {error}") from error
    if root.tag != "robot":
        raise ModelError(f"{file}: the root element is <{root.tag}>, a URDF begins with <robot>")
    return root.findall("link"), root.findall("joint")


def check_limits(file: Path, joint: ElementTree.Element) -> None:
    """Refuse limits that are missing, not finite, ≤ 0 (effort, velocity) or lower > upper."""
    if joint.get("type") not in ("revolute", "prismatic"):
        return
    where, limit = f"{file}: joint {joint.get('name')!r}", joint.find("limit")
    if limit is None:
        raise ModelError(f"{where} has no <limit lower= upper= effort= velocity=>")
    for key in ("effort", "velocity"):
        value = _number(where, limit, key, "missing")
        if value <= 0:
            raise ModelError(f"{where}: {key} limit {value:g} must be > 0 (passive joints too)")
    lower, upper = (_number(where, limit, key, "0") for key in ("lower", "upper"))
    if lower > upper:
        raise ModelError(f"{where}: lower limit {lower:g} is above the upper limit {upper:g}")


def link_mass(file: Path, link: ElementTree.Element) -> float:
    """Mass of a link (kg); 0 where it has no <inertial>."""
    inertial = link.find("inertial")
    if inertial is None:
        return 0.0
    return _number(f"{file}: link {link.get('name')!r}", inertial.find("mass"), "value", "missing")


def check_inertia(file: Path, link: ElementTree.Element) -> None:
    """Refuse an inertia that no body can have: mass, positive moments, triangle inequality."""
    inertial = link.find("inertial")
    if inertial is None:
        return
    where, mass = f"{file}: link {link.get('name')!r}", link_mass(file, link)
    tensor = inertial.find("inertia")
    xx, xy, xz, yy, yz, zz = (
        _number(where, tensor, key, "missing") for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    moments = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    slack = _TRIANGLE_SLACK * abs(moments).max()
    listed = ", ".join(f"{moment:.4g}" for moment in moments)
    if mass < 0 or (mass == 0 and moments.any()):
        raise ModelError(f"{where}: mass {mass:g} kg with principal moments {listed} kg m²")
    if moments[0] < -slack:
        raise ModelError(f"{where}: the inertia is not positive, principal moments {listed} kg m²")
    if moments[0] + moments[1] < moments[2] - slack:
        raise ModelError(
            f"{where}: no body has the principal moments {listed} kg m²: the largest exceeds the "
            "sum of the others"
        )


def check_joints(file: Path, model: pin.Model) -> None:
    """Refuse joints with nq ≠ nv, such as continuous, planar and floating ones."""
    for joint_name, joint_model in zip(model.names, model.joints, strict=True):
        if joint_model.nq != joint_model.nv and joint_model.nv > 0:
            raise ModelError(
                f"{file}: joint {joint_name!r} ({joint_model.shortname()}) has nq = "
                f"{joint_model.nq} but nv = {joint_model.nv}; only revolute and prismatic joints "
                "are supported: give a continuous joint limits, e.g. ±6.28 rad"
            )


def check_mass_matrix(file: Path, model: pin.Model, q: Array) -> None:
    """Refuse a mass matrix M(q) that is not positive definite; name the joints to blame."""
    if model.nv == 0:
        return
    M = np.array(pin.crba(model, model.createData(), q))
    diagonal = M.diagonal()
    singular = diagonal <= _DIAGONAL_FLOOR * diagonal.max()
    if not singular.any():
        scale = 1.0 / np.sqrt(diagonal)
        values, vectors = np.linalg.eigh(scale[:, None] * M * scale, UPLO="U")
        if values[0] > _EIGENVALUE_FLOOR:
            return
        singular = np.abs(vectors[:, 0]) > 0.1 * np.abs(vectors[:, 0]).max()
    names = [n for n, bad in zip(list(model.names)[1:], singular, strict=True) if bad]
    raise ModelError(
        f"{file}: the mass matrix is not positive definite at q = {np.round(q, 3).tolist()}: joint "
        f"{', '.join(names)} can move without moving mass; give the links behind it an <inertial>"
    )


def frame_id(model: pin.Model, name: str) -> int:
    """Index of the frame ``name``; a body's frame where a joint has the same name.

    Raises:
        ModelError: the model has no such frame (Pinocchio itself would return ``nframes``).
    """
    hits = [i for i, frame in enumerate(model.frames) if frame.name == name]
    if not hits:
        known = [frame.name for frame in model.frames]
        raise ModelError(f"model {model.name!r} has no frame {name!r}. {suggest(name, known)}")
    return next((i for i in hits if model.frames[i].type == pin.FrameType.BODY), hits[0])


def placement_difference(model: pin.Model, file: Path) -> tuple[float, str]:
    """Largest difference of a link placement between the model and yourdfpy, and that link.

    Entries of the 4×4 placements relative to the root link at seeded random configurations.
    """
    import yourdfpy

    data = model.createData()
    other = yourdfpy.URDF.load(str(file), load_meshes=False, build_scene_graph=True)
    root = other.base_link
    worst, where = 0.0, root
    for q in random_configurations(model, _CROSS_CHECK_SAMPLES):
        index = {name: model.joints[model.getJointId(name)].idx_q for name in list(model.names)[1:]}
        for name, joint in other.joint_map.items():
            if joint.mimic is not None:
                master = q[index[joint.mimic.joint]]
                q[index[name]] = joint.mimic.multiplier * master + joint.mimic.offset
        if index:
            other.update_cfg({name: q[index[name]] for name in other.actuated_joint_names})
        pin.framesForwardKinematics(model, data, q)
        X_WR = data.oMf[frame_id(model, root)]
        for link in other.link_map:
            ours = X_WR.actInv(data.oMf[frame_id(model, link)]).homogeneous
            difference = float(np.abs(ours - other.get_transform(link, root)).max())
            if not difference <= worst:
                worst, where = difference, link
    return worst, where


def random_configurations(model: pin.Model, count: int) -> Iterator[Array]:
    """Seeded uniform configurations between the position limits."""
    random = np.random.default_rng(0)
    for _ in range(count):
        yield random.uniform(model.lowerPositionLimit, model.upperPositionLimit)


def suggest(name: str, known: Iterable[str]) -> str:
    """Say "Did you mean x? There is: ..." for a name that is not among `known`."""
    names = sorted(set(known))
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    listed = f"There is: {', '.join(names) or 'nothing'}"
    return f"Did you mean {' or '.join(near)}? {listed}" if near else listed


def _number(where: str, element: ElementTree.Element | None, key: str, default: str) -> float:
    text = default if element is None else element.get(key, default)
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ModelError(f"{where}: {key} = {text!r} is not a finite number")
    return value

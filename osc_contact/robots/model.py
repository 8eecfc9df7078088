"""From a checked document to Pinocchio: it reads only text written here, from checked numbers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from html import escape

import numpy as np
import pinocchio as pin

from osc_contact.errors import ModelError
from osc_contact.robots.document import Document, Inertial, Joint
from osc_contact.robots.findings import ModelFinding, refuse, suggest
from osc_contact.spatial import Array

__all__ = [
    "SAMPLES",
    "build_model",
    "check_mass_matrix",
    "ends_of",
    "frame_id",
    "random_configurations",
]

SAMPLES = 20
_ENDLESS = 1e9
"""A position limit beyond (m or rad) is none; Pinocchio writes 1.8e308 for it."""
_DIAGONAL_FLOOR, _EIGENVALUE_FLOOR = 1e-13, 1e-11
"""Below these the mass matrix is singular: diagonal / (moved mass · its extent²), and eigenvalue at
unit diagonal. Neither changes with the units of length, mass or joints."""


def build_model(document: Document) -> pin.Model:
    """The fixed-base model. A continuous joint is a revolute joint with limits ∓inf: nq = nv.

    Raises:
        ModelError: Pinocchio refuses what all checks let through.
    """
    try:
        model = pin.buildModelFromXML(_text(document))
    except (ValueError, RuntimeError) as error:
        reason = f"Pinocchio refuses the file: {error}"
        refuse([ModelFinding("tree", document.file, 0, 0, "", reason, "details are on stderr")])
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        limits = document.joints[name].limits
        unbounded = document.joints[name].kind == "continuous"
        low[joint.idx_q] = limits.get("lower", -math.inf) if not unbounded else -math.inf
        high[joint.idx_q] = limits.get("upper", math.inf) if not unbounded else math.inf
    model.lowerPositionLimit, model.upperPositionLimit = low, high
    for name, (inertia, ratio) in document.rotors.items():
        if inertia > 0.0 and model.existJointName(name):
            v = model.joints[model.getJointId(name)].idx_v
            model.rotorInertia[v], model.rotorGearRatio[v] = inertia, ratio
    return model


def check_mass_matrix(model: pin.Model, document: Document | None = None) -> None:
    """Refuse a mass matrix that is not positive definite at neutral and 20 random configurations.

    Raises:
        ModelError: with the joints to blame.
    """
    if model.nv == 0:
        return
    data = model.createData()
    q = np.vstack((pin.neutral(model), *random_configurations(model, SAMPLES)))
    M = np.array([np.array(pin.crba(model, data, row)) for row in q])
    diagonal = np.einsum("kii->ki", M)
    reach = np.array([np.linalg.norm(X.translation) for X in model.jointPlacements])
    lever = np.array([np.linalg.norm(body.lever) for body in model.inertias])
    below = [list(subtree) for subtree in list(model.subtrees)[1:]]
    extent = np.array([reach[tree[1:]].sum() + lever[tree].max() for tree in below])
    turns = np.array(["P" not in joint.shortname()[10:] for joint in list(model.joints)[1:]])
    mass = np.array([inertia.mass for inertia in list(data.Ycrb)[1:]])
    floor = _DIAGONAL_FLOOR * mass * np.where(turns, extent**2, 1.0)
    with np.errstate(all="ignore"):
        scale = 1.0 / np.sqrt(diagonal)
        unit = scale[:, :, None] * M * scale[:, None, :]
    for k in range(len(q)):
        weak = ~(diagonal[k] > floor) | ~np.isfinite(scale[k])
        if not weak.any() and _is_positive(unit[k]):
            continue
        if not weak.any():
            vector = np.abs(np.linalg.eigh(unit[k], UPLO="U")[1][:, 0])
            weak = vector > 0.1 * vector.max()
        _refuse_mass_matrix(model, document, q[k], weak)


def random_configurations(model: pin.Model, count: int, seed: int = 0) -> Iterator[Array]:
    """Seeded uniform configurations between the position limits, ±π where there are none.

    Args:
        model: with position limits.
        count: how many.
        seed: of the random numbers.

    Yields:
        (nq,) joint positions (m, rad).
    """
    random = np.random.default_rng(seed)
    low = np.array(model.lowerPositionLimit)
    high = np.array(model.upperPositionLimit)
    open_below, open_above = ~(low > -_ENDLESS), ~(high < _ENDLESS)
    low[open_below] = np.where(open_above, -np.pi, high - 2 * np.pi)[open_below]
    high[open_above] = low[open_above] + 2 * np.pi
    for _ in range(count):
        yield random.uniform(low, high)


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


def ends_of(model: pin.Model) -> list[str]:
    """Names of the bodies at the ends of the tree, one for each joint that has one."""
    joints = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    carrying = {frame.parentFrame for frame in model.frames if frame.type in joints}
    ends: dict[int, str] = {}
    for i, frame in enumerate(model.frames):
        is_end = frame.type == pin.FrameType.BODY and not {i, frame.parentFrame} & carrying
        if is_end and frame.parentJoint > 0:
            ends.setdefault(frame.parentJoint, frame.name)
    return list(ends.values())


def _is_positive(unit: Array) -> bool:
    """Whether a matrix with unit diagonal has eigenvalues above the floor."""
    try:
        factor = np.linalg.cholesky((unit - _EIGENVALUE_FLOOR * np.eye(len(unit))).T)
    except np.linalg.LinAlgError:
        return False
    return bool(np.isfinite(factor).all())


def _refuse_mass_matrix(model: pin.Model, document: Document | None, q: Array, weak: Array) -> None:
    names = [n for n, bad in zip(list(model.names)[1:], weak, strict=True) if bad]
    joint = f"joint {', '.join(names)}"
    reason = (
        f"the mass matrix is not positive definite at q = {np.round(q, 3).tolist()}: {joint} can "
        "move without moving mass"
    )
    cure = "give the links behind it an <inertial>"
    if document is None:
        raise ModelError(f"model {model.name!r}: {reason}. {cure}")
    element = document.joints[names[0]].element
    place = (element.line, element.column, element.label())
    refuse([ModelFinding("mass matrix", document.file, *place, reason, cure)])


# The text that Pinocchio reads --------------------------------------------------------------------


def _text(document: Document) -> str:
    """A URDF of links and joints only; numbers round-trip, names are quoted."""
    parts = [f"<robot name={_quoted(document.name)}>"]
    for link in document.links.values():
        parts.append(f"<link name={_quoted(link.name)}>{_inertial(link.inertial)}</link>")
    parts.extend(_joint(joint) for joint in document.joints.values())
    return "".join((*parts, "</robot>"))


def _quoted(name: str) -> str:
    """A name as the value of an attribute; white space as it is, so that it comes back the same."""
    kept = {"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
    return '"' + "".join(kept.get(letter, letter) for letter in escape(name)) + '"'


def _inertial(inertial: Inertial | None) -> str:
    if inertial is None:
        return ""
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    moments = " ".join(f'{k}="{v!r}"' for k, v in zip(keys, inertial.moments, strict=True))
    return (
        f"<inertial>{_origin(inertial.xyz, inertial.rpy)}"
        f'<mass value="{inertial.mass!r}"/><inertia {moments}/></inertial>'
    )


def _joint(joint: Joint) -> str:
    kind = "revolute" if joint.kind == "continuous" else joint.kind
    limit = joint.limits
    return (
        f'<joint name={_quoted(joint.name)} type="{kind}">'
        f"<parent link={_quoted(joint.parent)}/><child link={_quoted(joint.child)}/>"
        f'{_origin(joint.xyz, joint.rpy)}<axis xyz="{_numbers(joint.axis)}"/>'
        f'<limit lower="0" upper="0" effort="{limit.get("effort", 0.0)!r}" '
        f'velocity="{limit.get("velocity", 0.0)!r}"/>'
        f'<dynamics damping="{joint.damping!r}" friction="{joint.friction!r}"/></joint>'
    )


def _origin(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> str:
    return f'<origin xyz="{_numbers(xyz)}" rpy="{_numbers(rpy)}"/>'


def _numbers(values: tuple[float, ...]) -> str:
    return " ".join(map(repr, values))

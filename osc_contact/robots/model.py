"""Pinocchio model of a checked document; Pinocchio reads only text written by this module."""

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin

from osc_contact.errors import ModelError, did_you_mean
from osc_contact.robots.elements import refuse, refuse_file
from osc_contact.robots.urdf import LIMITS, Document
from osc_contact.spatial import Array, norm

SAMPLES = 20  #: random configurations at which a mass matrix is checked
_NO_RANGE = {"lower": 0.0, "upper": 0.0}  # set afterwards: URDF has no infinite limits
_NO_END_STOP = 1e9
"""Larger position limits (m, rad) mean that there is no end stop; Pinocchio writes 1.8e308."""
_DIAGONAL_FLOOR = 1e-13
"""Least diagonal of a regular mass matrix over (moved mass · its extent²). Like the eigenvalue
below, it is independent of the units of length and mass."""
_EIGENVALUE_FLOOR = 1e-11
"""Least eigenvalue of a regular mass matrix that is scaled to unit diagonal."""


def build_model(document: Document) -> pin.Model:
    """Build the fixed-base Pinocchio model of a checked document.

    A continuous joint becomes a revolute joint with limits ∓inf, so that nq = nv.

    Args:
        document: document of a URDF without findings.

    Raises:
        ModelError: Pinocchio refuses the document.
    """
    try:
        model = pin.buildModelFromXML(_urdf_text(document))
    except (ValueError, RuntimeError) as error:
        refuse_file(
            "tree", document.file, f"Pinocchio refuses the file: {error}", "details are on stderr"
        )
    for j, name in enumerate(joint_names(model)):
        joint = document.joints[name]
        limits = {} if joint.kind == "continuous" else joint.limits
        model.lowerPositionLimit[j] = limits.get("lower", -math.inf)
        model.upperPositionLimit[j] = limits.get("upper", math.inf)
        inertia, ratio = document.rotors.get(name, (0.0, 1.0))
        if inertia > 0.0:
            model.rotorInertia[j] = inertia
            model.rotorGearRatio[j] = ratio
    return model


def _urdf_text(document: Document) -> str:
    """Write the text of a URDF with the links and joints of a document, without shapes.

    Numbers are written with all digits, names are quoted. `add` appends an element with its
    attributes.

    Args:
        document: checked document of the robot.
    """
    robot = ElementTree.Element("robot", name=document.name)

    def add(
        parent: ElementTree.Element, tag: str, **values: str | float | Sequence[float]
    ) -> ElementTree.Element:
        """Append an element to `parent`, with text or numbers as attributes; return it."""
        texts = {
            key: value if isinstance(value, str) else " ".join(map(repr, np.ravel(value).tolist()))
            for key, value in values.items()
        }
        return ElementTree.SubElement(parent, tag, texts)

    for link in document.links.values():
        node = add(robot, "link", name=link.name)
        if link.inertial is not None:
            body = add(node, "inertial")
            add(body, "origin", **link.inertial.origin)
            add(body, "mass", value=link.inertial.mass)
            add(body, "inertia", **link.inertial.moments)
    for joint in document.joints.values():
        # a continuous joint gets a revolute one without range, so that it has one coordinate in q
        kind = "revolute" if joint.kind == "continuous" else joint.kind
        node = add(robot, "joint", name=joint.name, type=kind)
        add(node, "parent", link=joint.parent)
        add(node, "child", link=joint.child)
        add(node, "origin", **joint.origin)
        add(node, "axis", xyz=joint.axis)
        add(node, "limit", **(dict.fromkeys(LIMITS, 0.0) | joint.limits | _NO_RANGE))
        add(node, "dynamics", **joint.losses)
    return ElementTree.tostring(robot, encoding="unicode")


def joint_names(model: pin.Model) -> list[str]:
    """Names of the joints that move, in model order."""
    return list(model.names)[1:]


def position_limits(model: pin.Model) -> tuple[Array, Array]:
    """Lowest and highest positions (nq,) of the joints (m, rad); ∓inf: no end stop."""
    return (np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit))


def slides(model: pin.Model, joint: int) -> bool:
    """True if a joint of a model, given by its number, is prismatic."""
    return model.joints[joint].shortname().startswith("JointModelP")


def joint_axis(model: pin.Model, joint: int) -> Array:
    """Motion subspace S (6,) of a joint of one degree of freedom, in its own frame.

    Args:
        model: model of a robot.
        joint: number of the joint in the model.
    """
    state = model.joints[joint].createData()
    # Pinocchio reads the joint's entry of the whole q, and does not check its length.
    model.joints[joint].calc(state, pin.neutral(model))
    return np.array(state.S).reshape(6)


def sliding(model: pin.Model) -> Array:
    """Flags (njoints − 1,) of the joints that are prismatic."""
    return np.array([slides(model, j) for j in range(1, model.njoints)], dtype=bool)


def rotors(model: pin.Model) -> Array:
    """Rotor inertia (n,) reflected to each joint: armature or, if that is 0, rotorInertia · ratio².

    In kg m² of a revolute joint, kg of a prismatic one.
    """
    geared_inertia = np.array(model.rotorInertia) * np.array(model.rotorGearRatio) ** 2
    return np.where(model.armature != 0.0, model.armature, geared_inertia)


def check_mass_matrix(model: pin.Model, document: Document | None = None) -> None:
    """Refuse a mass matrix that is not positive definite at neutral and 20 random configurations.

    Args:
        model: model of the robot.
        document: document of its URDF, for the place of an error; None: it has none.

    Raises:
        ModelError: the message names the joints that can move without moving mass.
    """
    if model.nv == 0:
        return
    data = model.createData()
    extent = _mass_distances(model)
    for q in (pin.neutral(model), *random_configurations(model, SAMPLES)):
        M = np.array(pin.crba(model, data, q))
        mass = np.array([inertia.mass for inertia in list(data.Ycrb)[1:]])
        floor = _DIAGONAL_FLOOR * mass * np.where(sliding(model), 1.0, extent**2)
        weak = _moves_no_mass(M, floor)
        if not weak.any():
            continue
        names = [name for name, is_weak in zip(joint_names(model), weak, strict=True) if is_weak]
        reason = (
            f"the mass matrix is not positive definite at q = {np.round(q, 3).tolist()}: "
            f"joint {', '.join(names)} can move without moving mass"
        )
        cure = "give the links behind it an <inertial>"
        if document is None:
            raise ModelError(f"model {model.name!r}: {reason}. {cure}")
        refuse([document.joints[names[0]].element.finding("mass matrix", reason, cure)])


def _mass_distances(model: pin.Model) -> Array:
    """Upper bounds (n,) of the distance of the mass that each joint moves from its axis (m).

    The bound is the sum of the link lengths beyond the joint and the largest distance of a centre
    of mass from its joint.

    Args:
        model: model of a robot.
    """
    length = np.array([norm(X.translation) for X in model.jointPlacements])
    lever = np.array([norm(body.lever) for body in model.inertias])
    subtrees = [list(subtree) for subtree in list(model.subtrees)[1:]]
    return np.array([length[tree[1:]].sum() + lever[tree].max() for tree in subtrees])


def _moves_no_mass(M: Array, floor: Array) -> Array:
    """Flag the joints (n,) that can move, alone or together, without moving mass.

    Args:
        M: (n, n) mass matrix.
        floor: (n,) least diagonal elements of a regular mass matrix.
    """
    with np.errstate(all="ignore"):
        scale = 1.0 / np.sqrt(np.diag(M))
        unit = scale[:, None] * M * scale
    weak = ~(np.diag(M) > floor) | ~np.isfinite(scale)
    if weak.any():
        return weak
    values, vectors = np.linalg.eigh(unit, UPLO="U")  # crba fills the upper triangle only
    if values[0] > _EIGENVALUE_FLOOR:
        return weak
    vector = np.abs(vectors[:, 0])
    return vector > 0.1 * vector.max()  # the joints with a considerable part in the motion


def random_configurations(model: pin.Model, count: int, seed: int = 0) -> Iterator[Array]:
    """Yield random configurations, uniform between the position limits; ±π without end stops.

    Args:
        model: model of the robot.
        count: number of configurations.
        seed: seed of the random numbers.

    Yields:
        (nq,) joint positions (m, rad).
    """
    random = np.random.default_rng(seed)
    low, high = position_limits(model)
    open_below = ~(low > -_NO_END_STOP)
    open_above = ~(high < _NO_END_STOP)
    low[open_below] = np.where(open_above, -np.pi, high - 2 * np.pi)[open_below]
    high[open_above] = low[open_above] + 2 * np.pi
    for _ in range(count):
        yield random.uniform(low, high)


def frame_id(model: pin.Model, name: str) -> int:
    """Find the index of a frame by its name; if a joint has the same name, that of the body.

    Args:
        model: model of the robot.
        name: name of the frame.

    Raises:
        ModelError: the model has no such frame (Pinocchio itself would return ``nframes``).
    """
    matches = [i for i, frame in enumerate(model.frames) if frame.name == name]
    if not matches:
        names = [frame.name for frame in model.frames]
        raise ModelError(f"model {model.name!r} has no frame {name!r}; {did_you_mean(name, names)}")
    for i in matches:
        if model.frames[i].type == pin.FrameType.BODY:
            return i
    return matches[0]


def ends_of(model: pin.Model) -> list[str]:
    """List the bodies without children, at most one for each joint, at the ends of the tree.

    Args:
        model: model of a robot.
    """
    joints = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
    carrying = {frame.parentFrame for frame in model.frames if frame.type in joints}
    ends: dict[int, str] = {}
    for i, frame in enumerate(model.frames):
        is_end = frame.type == pin.FrameType.BODY and not {i, frame.parentFrame} & carrying
        if is_end and frame.parentJoint > 0:
            ends.setdefault(frame.parentJoint, frame.name)
    return list(ends.values())

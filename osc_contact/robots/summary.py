"""What a robot is, in numbers: joints, masses, limits, and what its tips can do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.errors import ModelError
from osc_contact.robots.document import Document
from osc_contact.robots.joint_losses import UNITS, joint_losses, loss_words
from osc_contact.robots.model import ends_of, frame_id, random_configurations
from osc_contact.spatial import Array

__all__ = ["JointSummary", "RobotSummary", "TipSummary", "summarise", "summarise_mjcf"]

POSTURES = 200
NO_LIMIT = 1e30  #: N m, N, rad/s, m/s: as large as none
_SHOWN_TIPS = 12


@dataclass(frozen=True)
class JointSummary:
    """One joint: limits in rad, N m, rad/s, or m, N, m/s; moved_mass (kg): all that hangs on it.

    friction (N m, N), damping (N m s/rad, N s/m), armature (kg m², kg): see `joint_losses`.
    """

    name: str
    kind: str
    lower: float
    upper: float
    effort: float
    velocity: float
    moved_mass: float
    friction: float
    damping: float
    armature: float


@dataclass(frozen=True)
class TipSummary:
    """What the arm can do at one frame, over seeded random postures between the joint limits.

    Attributes:
        tip: the frame. joints: how many joints move it.
        mass: (kg) lightest and heaviest apparent mass over postures and directions, the inverse
            eigenvalues of J_v M⁻¹ J_vᵀ; inf where a direction cannot be moved.
        inertia: (kg m²) the same for J_ω M⁻¹ J_ωᵀ.
        mobility: smallest and largest value, over the postures, of each singular value of
            Lᵀ J K⁻ᵀ with M = K Kᵀ and L Lᵀ the inertia of the rigid body that carries the tip.
            Unit-free, independent of the frame: √(inertia of that body / inertia of the arm) in
            a direction, so 1 where only that body moves and 0 where the direction is lost. Empty
            where that body is no solid body (massless, or a point).
    """

    tip: str
    joints: int
    mass: tuple[float, float]
    inertia: tuple[float, float]
    mobility: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class RobotSummary:
    """Name, size and masses (kg) of a robot; `more_tips` counts end bodies left out of `tips`."""

    name: str
    dof: int
    links: int
    mass: float
    moving_mass: float
    joints: tuple[JointSummary, ...]
    tips: tuple[TipSummary, ...]
    more_tips: int

    @property
    def loss_words(self) -> str:
        """Friction, damping and armature of the joints in one line."""
        return loss_words(
            [
                {**asdict(one), "joint": one.name, "slides": one.kind == "prismatic"}
                for one in self.joints
            ]
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form; infinite numbers become null."""
        return _finite(asdict(self))


def summarise(model: pin.Model, document: Document, tip: str | None = None) -> RobotSummary:
    """Numbers of a loaded robot; tips are `tip`, or one link at each end of the tree.

    Args:
        model, document: of the robot. tip: name of a frame.

    Raises:
        ModelError: no such frame, or no joint moves it.
    """
    kinds = {name: joint.kind for name, joint in document.joints.items()}
    mass = sum(link.inertial.mass for link in document.links.values() if link.inertial)
    ends = _ends(model, document)
    return _summary(model, document.name, kinds, len(document.links), mass, ends, tip)


def summarise_mjcf(model: pin.Model, name: str, mass: float, tip: str | None) -> RobotSummary:
    """The same of a robot from MJCF.

    Args:
        model: as loaded. name, mass: of all of it (kg). tip: see `summarise`.

    Raises:
        ModelError: no such frame, or no joint moves it.
    """
    joints = zip(list(model.names)[1:], list(model.joints)[1:], strict=True)
    kinds = {
        joint: "prismatic" if form.shortname().startswith("JointModelP") else "revolute"
        for joint, form in joints
    }
    links = sum(frame.type == pin.FrameType.BODY for frame in model.frames)
    ends = [frame_id(model, end) for end in ends_of(model)]
    return _summary(model, name, kinds, links, mass, ends, tip)


def _summary(
    model: pin.Model,
    robot: str,
    kinds: Mapping[str, str],
    links: int,
    mass: float,
    ends: list[int],
    tip: str | None,
) -> RobotSummary:
    data = model.createData()
    pin.crba(model, data, pin.neutral(model))
    joints, losses = [], {one["joint"]: one for one in joint_losses(model)}
    for j in range(1, model.njoints):
        joint, name = model.joints[j], model.names[j]
        q, v = joint.idx_q, joint.idx_v
        joints.append(JointSummary(
            name, kinds[name],
            float(model.lowerPositionLimit[q]), float(model.upperPositionLimit[q]),
            _limit(model.upperEffortLimit[v]), _limit(model.upperVelocityLimit[v]),
            float(data.Ycrb[j].mass), *(losses[name][key] for key in UNITS),
        ))  # fmt: skip
    frames = ends if tip is None else [frame_id(model, tip)]
    if tip is not None and model.frames[frames[0]].parentJoint == 0:
        raise ModelError(f"{robot}: no joint moves the frame {tip!r}")
    return RobotSummary(
        robot,
        model.nv,
        links,
        mass,
        sum(float(inertia.mass) for inertia in list(model.inertias)[1:]),
        tuple(joints),
        tuple(_tip(model, frame) for frame in frames[:_SHOWN_TIPS]),
        len(frames[_SHOWN_TIPS:]),
    )


def _ends(model: pin.Model, document: Document) -> list[int]:
    """A link without children on every moving body that has one, in the order of the file."""
    parents = {joint.parent for joint in document.joints.values()}
    ends: dict[int, int] = {}
    for name in document.links:
        if name not in parents:
            index = frame_id(model, name)
            ends.setdefault(model.frames[index].parentJoint, index)
    return [index for joint, index in ends.items() if joint > 0]


def _tip(model: pin.Model, frame: int) -> TipSummary:
    data, placed = model.createData(), model.frames[frame]
    used = [model.joints[j].idx_v for j in list(model.supports[placed.parentJoint])[1:]]
    body = placed.placement.inverse().act(model.inertias[placed.parentJoint])
    moments = np.linalg.eigvalsh(body.inertia)
    solid = body.mass > 0 and moments[0] > 1e-9 * moments[2]
    L = np.linalg.cholesky(body.matrix()) if solid else np.zeros((6, 6))
    linear, angular, mobility = [], [], []
    for q in random_configurations(model, POSTURES):
        M = np.array(pin.crba(model, data, q))
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
        K = np.linalg.cholesky(M.T)
        A = np.linalg.solve(K, J.T).T
        linear.append(np.linalg.eigvalsh(A[:3] @ A[:3].T))
        angular.append(np.linalg.eigvalsh(A[3:] @ A[3:].T))
        mobility.append(np.linalg.svd(L.T @ A, compute_uv=False)[: len(used)])
    low, high = np.min(mobility, axis=0), np.max(mobility, axis=0)
    sigma = tuple((float(a), float(b)) for a, b in zip(low, high, strict=True)) if solid else ()
    return TipSummary(placed.name, len(used), _inverse(linear), _inverse(angular), sigma)


def _inverse(eigenvalues: list[Array]) -> tuple[float, float]:
    """(smallest, largest) of 1/λ; an eigenvalue at rounding level counts as 0."""
    values = np.array(eigenvalues)
    top = values.max(initial=0.0)
    if top <= 0.0:
        return float("inf"), float("inf")
    bottom = values.min()
    return 1.0 / float(top), 1.0 / float(bottom) if bottom > 1e-12 * top else float("inf")


def _limit(value: float) -> float:
    """Infinite where a file that names none got a huge number instead."""
    return float(value) if value < NO_LIMIT else float("inf")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value

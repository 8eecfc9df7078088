"""Description of a robot in numbers and words: joints, masses, limits, losses, tips, findings."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NotRequired, TypedDict

import numpy as np
import pinocchio as pin
from pydantic_core import to_jsonable_python

from osc_contact.errors import ModelError
from osc_contact.files import Json
from osc_contact.robots.checks import Inertias, JointLimits, check_mesh_files
from osc_contact.robots.elements import ModelFinding
from osc_contact.robots.loading import load
from osc_contact.robots.mjcf import is_mjcf, load_mjcf
from osc_contact.robots.model import (
    SAMPLES,
    ends_of,
    frame_id,
    joint_names,
    position_limits,
    random_configurations,
    rotors,
    sliding,
)
from osc_contact.spatial import Array, columns_of

POSTURES = 200  #: number of random postures for the description of a tip
NO_LIMIT = 1e30  #: larger limits mean that a joint has no limit (N m, N, rad/s, m/s)
_SHOWN_TIPS = 12  #: largest number of tips that are described


class JointLosses(TypedDict):
    """Losses and rotor inertia of a joint: friction, damping and armature.

    Units are N m, N m s/rad and kg m², of a prismatic joint N, N s/m and kg. Records of learned
    friction have only some of these keys.
    """

    joint: str
    slides: bool
    friction: NotRequired[float]
    damping: NotRequired[float]
    armature: NotRequired[float]


Loss = Literal["friction", "damping", "armature"]
#: Units of each quantity, of a revolute and of a prismatic joint.
_UNITS: dict[Loss, tuple[str, str]] = {
    "friction": ("N m", "N"),
    "damping": ("N m s/rad", "N s/m"),
    "armature": ("kg m²", "kg"),
}


def joint_losses(model: pin.Model, prefix: str = "") -> list[JointLosses]:
    """List friction, damping and rotor inertia of each joint of a model.

    Args:
        model: model of an arm, or of a robot.
        prefix: text that is put before the joints' names.
    """
    armature = rotors(model)
    slides = sliding(model)
    return [
        JointLosses(
            joint=f"{prefix}{name}",
            slides=bool(slides[j]),
            friction=float(model.upperDryFrictionLimit[j]),
            damping=float(model.damping[j]),
            armature=float(armature[j]),
        )
        for j, name in enumerate(joint_names(model))
    ]


def losses_by_arm(losses: Sequence[JointLosses]) -> Iterator[tuple[str, str]]:
    """Yield the name of each arm, and a line of text on the losses of its joints.

    Args:
        losses: losses of joints whose names are ARM/JOINT.
    """
    arms: dict[str, list[JointLosses]] = {}
    for values in losses:
        arm, _, joint = values["joint"].rpartition("/")
        without_arm = values.copy()
        without_arm["joint"] = joint
        arms.setdefault(arm, []).append(without_arm)
    for arm, joints in arms.items():
        yield (arm, loss_words(joints))


def loss_words(joints: Sequence[JointLosses]) -> str:
    """Describe friction, damping and armature of joints in one line; zeros are not listed.

    Joints with equal values are named together.

    Args:
        joints: losses of at least one joint.
    """
    words = []
    for key, (turning_unit, sliding_unit) in _UNITS.items():
        if key not in joints[0]:
            continue
        groups: dict[tuple[float, str], list[str]] = {}
        for values in joints:
            if values[key]:
                group = (values[key], sliding_unit if values["slides"] else turning_unit)
                groups.setdefault(group, []).append(values["joint"])
        parts = []
        for (value, unit), names in groups.items():
            where = "every joint" if len(names) == len(joints) else ", ".join(names)
            parts.append(f"{value:.3g} {unit} ({where})")
        words.append(f"{key} {', '.join(parts)}" if parts else f"no {key}")
    return "; ".join(words)


def friction_warnings(
    model: pin.Model, q: Array, share: float, rate: float, passive: Sequence[str] = ()
) -> Iterator[str]:
    """Yield warnings of joints whose damping or rotor inertia endangers the friction observer.

    Args:
        model: model of an arm.
        q: (n,) posture (rad, m).
        share: share of the friction that the observer compensates, of `control.joint_friction`;
            0: no observer.
        rate: bandwidth of the observer (1/s).
        passive: names of joints without a motor, which have no observer.

    Yields:
        At most one sentence on damping, then at most one on rotor inertias.
    """
    # inertia (n,) of each joint while the others are free, with the rotors that the law assumes in
    # place of those in the mass matrix
    M = pin.crba(model, model.createData(), q)
    M_law = M - np.diag(model.armature) + np.diag(rotors(model))
    inertias = 1.0 / np.diag(np.linalg.inv(M_law))
    yield from _damping_warning(model, inertias, rate)
    if share > 0.0:
        yield from _rotor_warning(model, inertias, share, passive)


def _damping_warning(model: pin.Model, inertias: Array, rate: float) -> Iterator[str]:
    """Yield a warning if the damping of a joint exceeds its inertia times the observer's bandwidth.

    Up to the observer's bandwidth K an unknown damping D acts like an inertia D/K. It outweighs the
    inertia m of the joint if D/m > K.

    Args:
        model: model of an arm.
        inertias: (n,) inertia m of each joint while the others are free (kg m², kg).
        rate: bandwidth K of the friction observer (1/s).
    """
    excesses = [
        f"{damping / inertia:.3g} 1/s ({name})"
        for name, damping, inertia in zip(joint_names(model), model.damping, inertias, strict=True)
        if damping > rate * inertia
    ]
    if excesses:
        yield (
            f"damping over inertia {', '.join(excesses)}, more than {rate:.0f} 1/s: an error of "
            "the damping moves these joints more than their inertia does; give their rotors "
            "(armature)"
        )


def _rotor_warning(
    model: pin.Model, inertias: Array, share: float, passive: Sequence[str]
) -> Iterator[str]:
    """Yield a warning with the least rotor inertias for which the friction observer is stable.

    The observer with the share g is stable for every delay if the assumed inertia m of a joint is
    at most 1 + 1/g times the true one, so that the true one is at least m − m/(1 + g). Links
    without their rotor A have m − A; a rotor smaller than A − m/(1 + g) is therefore too small.

    Args:
        model: model of an arm.
        inertias: (n,) inertia m of each joint while the others are free (kg m², kg).
        share: share g of the friction that the observer compensates, > 0.
        passive: names of joints without a motor, which have no observer.
    """
    least_rotors = [
        f"{rotor - inertia / (1.0 + share):.2g} ({name}, {rotor:.2g} in the model)"
        for name, rotor, inertia in zip(joint_names(model), rotors(model), inertias, strict=True)
        if rotor > inertia / (1.0 + share) and name not in passive
    ]
    if least_rotors:
        limits = ", ".join(least_rotors)
        yield f"rotors that are smaller than {limits} make the friction observer unstable"


@dataclass(frozen=True)
class JointSummary:
    """Limits, moved mass and losses of a joint; units of a prismatic joint come second.

    Attributes:
        name: name of the joint.
        kind: "revolute", "continuous" or "prismatic".
        lower, upper: range of positions (rad, m); ∓inf: no end stop.
        effort: largest torque (N m, N).
        velocity: largest speed (rad/s, m/s).
        moved_mass: mass of all links that the joint moves (kg).
        friction: dry friction (N m, N).
        damping: viscous friction (N m s/rad, N s/m).
        armature: rotor inertia reflected to the joint (kg m², kg).
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
    """Apparent inertia and mobility at a frame, over random postures between the joint limits.

    Attributes:
        tip: name of the frame.
        joints: number of joints that move it.
        mass: smallest and largest apparent mass over postures and directions, the inverse
            eigenvalues of J_v M⁻¹ J_vᵀ (kg); inf if some direction cannot be moved.
        inertia: smallest and largest apparent moment of inertia, the inverse eigenvalues of
            J_ω M⁻¹ J_ωᵀ (kg m²).
        mobility: smallest and largest value, over the postures, of each singular value of
            Lᵀ J K⁻ᵀ with M = K Kᵀ and L Lᵀ the inertia of the rigid body that carries the tip.
            It is dimensionless and independent of the frame: √(inertia of that body / inertia of
            the arm) in a direction, 1 if only that body moves, 0 if the direction is lost. Empty if
            that body is massless or a point.
    """

    tip: str
    joints: int
    mass: tuple[float, float]
    inertia: tuple[float, float]
    mobility: tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class RobotSummary:
    """Description of a robot.

    Attributes:
        name: name of the robot.
        dof: number of joints that move.
        links: number of links.
        mass, moving_mass: mass of all links, and of the moving ones (kg).
        joints: the joints in model order.
        losses: losses of the joints, as text.
        tips: description of frames at the ends of the tree.
        more_tips: number of ends that are left out of `tips`.
    """

    name: str
    dof: int
    links: int
    mass: float
    moving_mass: float
    joints: tuple[JointSummary, ...]
    losses: str
    tips: tuple[TipSummary, ...]
    more_tips: int


def summarise(model: pin.Model, tip: str | None = None) -> RobotSummary:
    """Describe a robot.

    Args:
        model: model of the robot.
        tip: name of the frame to describe; None: a link at each end of the tree.

    Raises:
        ModelError: there is no such frame, or no joint moves it.
    """
    losses = joint_losses(model)
    frames = [frame_id(model, name) for name in (ends_of(model) if tip is None else [tip])]
    if tip is not None and model.frames[frames[0]].parentJoint == 0:
        raise ModelError(f"{model.name}: no joint moves the frame {tip!r}")
    masses = [inertia.mass for inertia in model.inertias]
    return RobotSummary(
        name=model.name,
        dof=model.nv,
        links=sum(frame.type == pin.FrameType.BODY for frame in model.frames),
        mass=sum(masses),
        moving_mass=sum(masses[1:]),
        joints=_joint_summaries(model, losses),
        losses=loss_words(losses) if losses else "",
        tips=tuple(_tip_summary(model, frame) for frame in frames[:_SHOWN_TIPS]),
        more_tips=len(frames[_SHOWN_TIPS:]),
    )


def _joint_summaries(model: pin.Model, losses: Sequence[JointLosses]) -> tuple[JointSummary, ...]:
    """Describe all joints of a model: kind, limits, moved mass (kg), friction, damping, rotor.

    Args:
        model: model of the robot.
        losses: losses of its joints, see `joint_losses`.
    """
    data = model.createData()
    # composite inertias: element j + 1 of Ycrb has the mass of all links that joint j moves
    pin.crba(model, data, pin.neutral(model))
    lower, upper = position_limits(model)
    summaries = []
    for j, values in enumerate(losses):
        # Pinocchio does not keep the type: a joint without limits was continuous
        if values["slides"]:
            kind = "prismatic"
        elif lower[j] == -np.inf and upper[j] == np.inf:
            kind = "continuous"
        else:
            kind = "revolute"
        summaries.append(
            JointSummary(
                name=values["joint"],
                kind=kind,
                lower=float(lower[j]),
                upper=float(upper[j]),
                effort=_limit_or_inf(model.upperEffortLimit[j]),
                velocity=_limit_or_inf(model.upperVelocityLimit[j]),
                moved_mass=data.Ycrb[j + 1].mass,
                friction=values["friction"],
                damping=values["damping"],
                armature=values["armature"],
            )
        )
    return tuple(summaries)


def _tip_summary(model: pin.Model, frame: int) -> TipSummary:
    """Describe apparent inertia and mobility at a frame over random postures, see `TipSummary`.

    Args:
        model: model of the robot.
        frame: number of the frame in the model.
    """
    data = model.createData()
    tip = model.frames[frame]
    joints = len(model.supports[tip.parentJoint]) - 1  # without the universe

    # factor L (6, 6) of the inertia of the body that carries the tip, in the axes of the tip
    body = tip.placement.inverse().act(model.inertias[tip.parentJoint])
    moments = np.linalg.eigvalsh(body.inertia)
    is_solid = body.mass > 0 and moments[0] > 1e-9 * moments[2]
    L = np.linalg.cholesky(body.matrix()) if is_solid else np.zeros((6, 6))

    linear = []
    angular = []
    mobility = []
    for q in random_configurations(model, POSTURES):
        M = np.array(pin.crba(model, data, q))
        J = columns_of(pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL))
        # A (6, n) = J K⁻ᵀ with M = K Kᵀ, so that A Aᵀ = J M⁻¹ Jᵀ is the inverse inertia at the tip
        A = np.linalg.solve(np.linalg.cholesky(M.T), J.T).T
        linear.append(np.linalg.eigvalsh(A[:3] @ A[:3].T))
        angular.append(np.linalg.eigvalsh(A[3:] @ A[3:].T))
        mobility.append(np.linalg.svd(L.T @ A, compute_uv=False)[:joints])
    extremes = np.column_stack((np.min(mobility, axis=0), np.max(mobility, axis=0)))
    sigma = tuple(map(tuple, extremes.tolist())) if is_solid else ()
    return TipSummary(tip.name, joints, _inverse_range(linear), _inverse_range(angular), sigma)


def _inverse_range(eigenvalues: list[Array]) -> tuple[float, float]:
    """Compute the smallest and the largest 1/λ of eigenvalues λ ≥ 0 of all postures.

    Args:
        eigenvalues: (3,) eigenvalues for each posture; those within rounding errors of 0 give inf.
    """
    values = np.array(eigenvalues)
    values[values <= 1e-12 * values.max()] = 0.0
    with np.errstate(divide="ignore"):
        inverse = 1.0 / values
    return (float(inverse.min()), float(inverse.max()))


def _limit_or_inf(value: float) -> float:
    """Limit of a joint; inf for numbers from `NO_LIMIT` on, which mean that there is no limit."""
    return float(value) if value < NO_LIMIT else float("inf")


@dataclass(frozen=True)
class RobotReport:
    """Result of the checks of a robot's file.

    Attributes:
        file: the file.
        findings: errors of the file; empty for a sound robot.
        meshes_missing: number of mesh files that were not found; the dynamics does not need them.
        summary: description of the robot; None if it was refused.
    """

    file: Path
    findings: tuple[ModelFinding, ...]
    meshes_missing: int = 0
    summary: RobotSummary | None = None

    @property
    def sound(self) -> bool:
        """True without findings."""
        return not self.findings

    def lines(self) -> list[str]:
        """Lines of text with the result, for the terminal.

        They are the findings of a file that was refused (`summary` is None); else numbers of
        joints and links, masses (kg), losses of the joints, and what was left out.
        """
        if self.summary is None:
            count = f"{len(self.findings)} finding{'s' if len(self.findings) > 1 else ''}"
            return [*map(str, self.findings), f"{self.file}: refused, {count}"]
        robot = self.summary
        lines = [
            f"{self.file}: sound",
            f"{robot.dof} joints move, {robot.links} links, {robot.mass:.4g} kg of which "
            f"{robot.moving_mass:.4g} kg move; mass matrix positive definite at {SAMPLES + 1} "
            "configurations",
        ]
        if robot.joints:
            lines.append(f"joints: {robot.losses}")
        if self.meshes_missing:
            lines.append(f"{self.meshes_missing} mesh files were not found (not needed here)")
        if robot.more_tips:
            lines.append(f"{robot.more_tips} more tips are not shown: name one with --tip")
        return lines

    def as_dict(self) -> Json:
        """Result as JSON data; the summary is under the key "robot"."""
        without_file = {"findings": {"__all__": {"file"}}}
        report = to_jsonable_python(self, exclude=without_file, inf_nan_mode="null")
        return report | {"sound": self.sound, "robot": report.pop("summary")}


def check_robot(
    path: Path | str,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    inertias: Inertias = "possible",
    package_dirs: Sequence[Path | str] = (),
    tip: str | None = None,
) -> RobotReport:
    """Load a URDF or an MJCF file with all checks, mesh files included, and describe the robot.

    Args:
        path: the file.
        limits: limits by hand, see `load_model`.
        inertias, package_dirs: of a URDF, see `load_model`.
        tip: name of the frame to describe; None: a link at each end of the tree.

    Raises:
        ModelError: there is no such file, or no such frame.
        InvalidInputError: limits for joints that do not exist.
    """
    file = Path(path)
    missing: Sequence[ModelFinding] = ()
    try:
        if is_mjcf(file):
            model = load_mjcf(file, tip, limits=limits)
            model.name = file.stem
        else:
            model, document = load(
                file, limits=limits, inertias=inertias, package_dirs=package_dirs
            )
            folders = [Path(folder) for folder in package_dirs]
            unusable, missing = check_mesh_files(document, folders)
            if unusable:
                return RobotReport(file, tuple(unusable))
    except ModelError as error:
        if isinstance(error.__cause__, ImportError) or not file.is_file():
            raise
        finding = ModelFinding("mjcf", file, 0, 0, "", str(error), "")
        return RobotReport(file, error.findings or (finding,))
    return RobotReport(file, (), len(missing), summarise(model, tip))

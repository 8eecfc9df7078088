"""What a robot is, in numbers and in words: joints, masses, limits, losses, tips, and a verdict."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from pydantic_core import to_jsonable_python

from osc_contact.errors import ModelError
from osc_contact.robots.checks import Inertias, JointLimits, check_mesh_files
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
from osc_contact.robots.urdf import ModelFinding
from osc_contact.spatial import Array, columns_of

POSTURES = 200
NO_LIMIT = 1e30  #: N m, N, rad/s, m/s: as large as none
_SHOWN_TIPS = 12
_UNITS = {
    "friction": ("N m", "N"),
    "damping": ("N m s/rad", "N s/m"),
    "armature": ("kg m²", "kg"),
}
"""What a joint loses and carries; units of a turning and of a sliding joint."""


def joint_losses(model: pin.Model, prefix: str = "") -> list[dict[str, Any]]:
    """What each joint of a model loses and carries.

    Args:
        model: of one arm, or of a robot. prefix: of the joints' names.

    Returns:
        Of each joint its name, friction (N m, N), damping (N m s/rad, N s/m), armature (kg m²,
        kg), and whether it slides.
    """
    quantities = (model.upperDryFrictionLimit, model.damping, rotors(model))
    rows = zip(joint_names(model), *quantities, sliding(model), strict=True)
    return [
        {"joint": f"{prefix}{name}", "slides": bool(slides)}
        | dict(zip(_UNITS, map(float, losses), strict=True))
        for name, *losses, slides in rows
    ]


def losses_by_arm(losses: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Each arm's name and its joints in words.

    Args:
        losses: of `joint_losses`, their names ARM/JOINT.
    """
    arms: dict[str, list[Mapping[str, Any]]] = {}
    for values in losses:
        arm, _, joint = values["joint"].rpartition("/")
        arms.setdefault(arm, []).append({**values, "joint": joint})
    for arm, joints in arms.items():
        yield (arm, loss_words(joints))


def loss_words(joints: Sequence[Mapping[str, Any]]) -> str:
    """Friction, damping and armature of some joints, those that are not zero, in one line."""
    words = []
    for key, units in _UNITS.items():
        if key not in joints[0]:
            continue
        groups: dict[tuple[float, str], list[str]] = {}
        for values in joints:
            if values[key]:
                group = (values[key], units[values["slides"]])
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
    """Joints whose damping weighs more than their inertia, and the least that rotors may be.

    With m = 1/(M⁻¹)_jj, the inertia of a joint while the others are free: damping D that is not
    known moves the joint like an inertia D/K, which counts where D/m > K; and the observer with
    share g is stable for every delay while the assumed m is at most 1 + 1/g times the true one.

    Args:
        model: of one arm. q: its posture. share: g of `control.joint_friction`. rate: K (1/s).
        passive: joints without a motor, which has no observer.
    """
    M = pin.crba(model, model.createData(), q)
    A = rotors(model)
    m = 1.0 / np.diag(np.linalg.inv(M - np.diag(model.armature) + np.diag(A)))
    names = joint_names(model)
    fast = [
        f"{d / own:.3g} 1/s ({name})"
        for name, d, own in zip(names, model.damping, m, strict=True)
        if d > rate * own
    ]
    if fast:
        yield (
            f"damping over inertia {', '.join(fast)}, more than {rate:.0f} 1/s: an error of the "
            "damping moves these joints more than their inertia does; give their rotors (armature)"
        )
    least = [
        f"{a - own / (1.0 + share):.2g} ({name}, {a:.2g} in the model)"
        for name, a, own in zip(names, A, m, strict=True)
        if share > 0.0 and a > own / (1.0 + share) and name not in passive
    ]
    if least:
        yield f"rotors that are smaller than {', '.join(least)} make the friction observer unstable"


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
    """Name, size and masses (kg) of a robot; `losses` of its joints in words; `more_tips` counts
    end bodies left out of `tips`."""

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
    """Numbers of a loaded robot; tips are `tip`, or one link at each end of the tree.

    Args:
        model: of the robot. tip: name of a frame.

    Raises:
        ModelError: no such frame, or no joint moves it.
    """
    data = model.createData()
    pin.crba(model, data, pin.neutral(model))
    losses = joint_losses(model)
    joints = tuple(_joint(model, data, j, **one) for j, one in enumerate(losses))
    frames = [frame_id(model, name) for name in (ends_of(model) if tip is None else [tip])]
    if tip is not None and model.frames[frames[0]].parentJoint == 0:
        raise ModelError(f"{model.name}: no joint moves the frame {tip!r}")
    masses = [inertia.mass for inertia in model.inertias]
    return RobotSummary(
        model.name,
        model.nv,
        sum(frame.type == pin.FrameType.BODY for frame in model.frames),
        sum(masses),
        sum(masses[1:]),
        joints,
        loss_words(losses) if losses else "",
        tuple(_tip(model, frame) for frame in frames[:_SHOWN_TIPS]),
        len(frames[_SHOWN_TIPS:]),
    )


def _joint(
    model: pin.Model, data: pin.Data, j: int, joint: str, slides: bool, **losses: float
) -> JointSummary:
    lower, upper = (float(limits[j]) for limits in position_limits(model))
    turning = "continuous" if lower == -upper == -np.inf else "revolute"
    return JointSummary(
        joint,
        "prismatic" if slides else turning,
        lower,
        upper,
        _limit(model.upperEffortLimit[j]),
        _limit(model.upperVelocityLimit[j]),
        data.Ycrb[j + 1].mass,
        **losses,
    )


def _tip(model: pin.Model, frame: int) -> TipSummary:
    data = model.createData()
    placed = model.frames[frame]
    joints = len(model.supports[placed.parentJoint]) - 1  # without the universe
    body = placed.placement.inverse().act(model.inertias[placed.parentJoint])
    moments = np.linalg.eigvalsh(body.inertia)
    solid = body.mass > 0 and moments[0] > 1e-9 * moments[2]
    L = np.linalg.cholesky(body.matrix()) if solid else np.zeros((6, 6))
    linear = []
    angular = []
    mobility = []
    for q in random_configurations(model, POSTURES):
        M = np.array(pin.crba(model, data, q))
        J = columns_of(pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL))
        A = np.linalg.solve(np.linalg.cholesky(M.T), J.T).T
        linear.append(np.linalg.eigvalsh(A[:3] @ A[:3].T))
        angular.append(np.linalg.eigvalsh(A[3:] @ A[3:].T))
        mobility.append(np.linalg.svd(L.T @ A, compute_uv=False)[:joints])
    extremes = np.column_stack((np.min(mobility, axis=0), np.max(mobility, axis=0)))
    sigma = tuple(map(tuple, extremes.tolist())) if solid else ()
    return TipSummary(placed.name, joints, _inverse(linear), _inverse(angular), sigma)


def _inverse(eigenvalues: list[Array]) -> tuple[float, float]:
    """(smallest, largest) of 1/λ; an eigenvalue at rounding level counts as 0."""
    values = np.array(eigenvalues)
    values[values <= 1e-12 * values.max()] = 0.0
    with np.errstate(divide="ignore"):
        inverse = 1.0 / values
    return (float(inverse.min()), float(inverse.max()))


def _limit(value: float) -> float:
    """Infinite where a file that names none got a huge number instead."""
    return float(value) if value < NO_LIMIT else float("inf")


@dataclass(frozen=True)
class RobotReport:
    """The verdict on a URDF.

    Attributes:
        file: the URDF. findings: what is wrong with it, empty for a sound robot.
        meshes_missing: mesh files that were not found (they are not needed for the dynamics).
        summary: the robot, None if it was refused.
    """

    file: Path
    findings: tuple[ModelFinding, ...]
    meshes_missing: int = 0
    summary: RobotSummary | None = None

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def lines(self) -> list[str]:
        """The verdict in plain words."""
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

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        left_out = {"findings": {"__all__": {"file"}}}
        whole = to_jsonable_python(self, exclude=left_out, inf_nan_mode="null")
        return whole | {"sound": self.sound, "robot": whole.pop("summary")}


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
        path, limits: as for `load_model`, or `load_mjcf`. inertias, package_dirs: of a URDF.
        tip: the frame to describe; default: one at each end of the tree.

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
            wrong, missing = check_mesh_files(document, [Path(one) for one in package_dirs])
            if wrong:
                return RobotReport(file, tuple(wrong))
    except ModelError as error:
        if isinstance(error.__cause__, ImportError) or not file.is_file():
            raise
        whole = ModelFinding("mjcf", file, 0, 0, "", str(error), "")
        return RobotReport(file, error.findings or (whole,))
    return RobotReport(file, (), len(missing), summarise(model, tip))

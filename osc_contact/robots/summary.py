"""What a robot is, in numbers and in words: joints, masses, limits, losses, tips, and a verdict."""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from pydantic_core import to_jsonable_python

from osc_contact.errors import ModelError
from osc_contact.robots.checks import Inertias, JointLimits, check_mesh_files
from osc_contact.robots.loading import compare, load
from osc_contact.robots.mjcf import compile_mjcf, is_mjcf, load_mjcf, placement_difference
from osc_contact.robots.model import (
    SAMPLES,
    ends_of,
    frame_id,
    joint_names,
    random_configurations,
    rotors,
    sliding,
)
from osc_contact.robots.urdf import Document, ModelFinding
from osc_contact.spatial import Array

jsonable = partial(to_jsonable_python, inf_nan_mode="null")
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
        yield arm, loss_words(joints)


def loss_words(joints: Sequence[Mapping[str, Any]]) -> str:
    """Friction, damping and armature of some joints, those that are not zero, in one line."""
    words = []
    for key in (key for key in _UNITS if key in joints[0]):
        units = _UNITS[key]
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
                asdict(one) | {"joint": one.name, "slides": one.kind == "prismatic"}
                for one in self.joints
            ]
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form; infinite numbers become null."""
        return jsonable(self)


def summarise(model: pin.Model, document: Document, tip: str | None = None) -> RobotSummary:
    """Numbers of a loaded robot; tips are `tip`, or one link at each end of the tree.

    Args:
        model, document: of the robot. tip: name of a frame.

    Raises:
        ModelError: no such frame, or no joint moves it.
    """
    kinds = {name: joint.kind for name, joint in document.joints.items()}
    mass = sum(link.inertial.mass for link in document.links.values() if link.inertial)
    return _summary(model, document.name, kinds, mass, tip)


def _summary(
    model: pin.Model, robot: str, kinds: Mapping[str, str], mass: float, tip: str | None
) -> RobotSummary:
    data = model.createData()
    pin.crba(model, data, pin.neutral(model))
    joints = []
    for j, losses in enumerate(joint_losses(model)):
        name = losses.pop("joint")
        kind = "prismatic" if losses.pop("slides") else "revolute"
        joints.append(
            JointSummary(
                name,
                kinds.get(name, kind),
                model.lowerPositionLimit[j],
                model.upperPositionLimit[j],
                _limit(model.upperEffortLimit[j]),
                _limit(model.upperVelocityLimit[j]),
                data.Ycrb[j + 1].mass,
                **losses,
            )
        )
    frames = [frame_id(model, name) for name in (ends_of(model) if tip is None else [tip])]
    if tip is not None and model.frames[frames[0]].parentJoint == 0:
        raise ModelError(f"{robot}: no joint moves the frame {tip!r}")
    return RobotSummary(
        robot,
        model.nv,
        sum(frame.type == pin.FrameType.BODY for frame in model.frames),
        mass,
        sum(inertia.mass for inertia in list(model.inertias)[1:]),
        tuple(joints),
        tuple(_tip(model, frame) for frame in frames[:_SHOWN_TIPS]),
        len(frames[_SHOWN_TIPS:]),
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
        J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
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
    return float(inverse.min()), float(inverse.max())


def _limit(value: float) -> float:
    """Infinite where a file that names none got a huge number instead."""
    return float(value) if value < NO_LIMIT else float("inf")


@dataclass(frozen=True)
class RobotReport:
    """The verdict on a URDF.

    Attributes:
        file: the URDF. findings: what is wrong with it, empty for a sound robot.
        load_ms: time of the checked load. reader_difference: largest difference of a link
            placement from the second reader (m or without unit).
        meshes_missing: mesh files that were not found (they are not needed for the dynamics).
        summary: the robot, None if it was refused.
    """

    file: Path
    findings: tuple[ModelFinding, ...]
    load_ms: float = 0.0
    reader_difference: float = 0.0
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
            f"{self.file}: sound, loaded in {self.load_ms:.1f} ms",
            f"{robot.dof} joints move, {robot.links} links, {robot.mass:.4g} kg of which "
            f"{robot.moving_mass:.4g} kg move; mass matrix positive definite at {SAMPLES + 1} "
            f"configurations; a second reader differs by {self.reader_difference:.1g} at most",
        ]
        if robot.joints:
            lines.append(f"joints: {robot.loss_words}")
        if self.meshes_missing:
            lines.append(f"{self.meshes_missing} mesh files were not found (not needed here)")
        if robot.more_tips:
            lines.append(f"{robot.more_tips} more tips are not shown: name one with --tip")
        return lines

    def as_dict(self) -> dict[str, Any]:
        """JSON-able form."""
        whole = jsonable(self, exclude={"findings": {"__all__": {"file"}}})
        return whole | {"sound": self.sound, "robot": whole.pop("summary")}


def check_robot(
    path: Path | str,
    *,
    limits: Mapping[str, JointLimits] | None = None,
    inertias: Inertias = "possible",
    package_dirs: Sequence[Path | str] = (),
    tip: str | None = None,
) -> RobotReport:
    """Load a URDF with all checks, mesh files and the second reader included, and describe it.

    An MJCF file is compiled by MuJoCo, whose kinematics are the second reader.

    Args:
        path, limits: as for `load_model`, or `load_mjcf`. inertias, package_dirs: of a URDF.
        tip: the frame to describe; default: one at each end of the tree.

    Raises:
        ModelError: there is no such file, or no such frame.
        InvalidInputError: limits for joints that do not exist.
    """
    file = Path(path)
    if is_mjcf(file):
        return _check_mjcf(file, limits, tip)
    start = time.perf_counter()
    try:
        loaded = load(file, limits=limits, inertias=inertias, package_dirs=package_dirs)
        load_ms = 1e3 * (time.perf_counter() - start)
        missing = check_mesh_files(loaded.document, loaded.package_dirs)
        loaded.document.require()
        difference = compare(loaded.model, file)
    except ModelError as error:
        if not error.findings or not file.is_file():
            raise
        return RobotReport(file, error.findings)
    summary = summarise(loaded.model, loaded.document, tip)
    return RobotReport(file, (), load_ms, difference, len(missing), summary)


def _check_mjcf(
    file: Path, limits: Mapping[str, JointLimits] | None, tip: str | None
) -> RobotReport:
    start = time.perf_counter()
    try:
        mj = compile_mjcf(file)
        model = load_mjcf(mj, tip, limits=limits)
        load_ms = 1e3 * (time.perf_counter() - start)
        difference = placement_difference(mj, model)
    except ModelError as error:
        if isinstance(error.__cause__, ImportError):
            raise
        return RobotReport(file, (ModelFinding("mjcf", file, 0, 0, "", str(error), ""),))
    summary = _summary(model, file.stem, {}, mj.body_subtreemass[0], tip)
    return RobotReport(file, (), load_ms, difference, 0, summary)

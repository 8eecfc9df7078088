"""Forward and inverse kinematics of arms and scenarios, within joint limits, for people.

And a first scenario for any arm: it presses a stylus on a plate and slides along it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from pydantic import TypeAdapter, ValidationError

from osc_contact import robots
from osc_contact.contacts.pairs.pair import triad
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import object_pose, outside_limits, reach
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, ModelError, OscContactError, ScenarioError
from osc_contact.files import Json
from osc_contact.lab.checks.preflight import preflight
from osc_contact.lab.rig.rig import build_chain, build_rig, given_pose, posture_of
from osc_contact.lab.runs.run import run
from osc_contact.lab.runs.verdict import metrics
from osc_contact.lab.scenarios.loader import parse_scenario
from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.robots.model import joint_names, position_limits, sliding
from osc_contact.settings.quantities import AngleVec3, JointValue, Vec3
from osc_contact.spatial import Array, columns_of, norm, pose_error

TRIES = 40  #: random postures from which a pose is sought, after the given one
#: a pose that is missed by less is reached
MISS_M = 1e-6
MISS_RAD = 1e-5
FARTHEST_M = 20.0  #: m; no arm's work is further from the origin of its scene
VECTORS: dict[str, TypeAdapter[Any]] = {
    "xyz": TypeAdapter(Vec3),
    "rpy": TypeAdapter(AngleVec3),
    "posture": TypeAdapter(tuple[JointValue, ...]),
}


@dataclass(frozen=True)
class Posture:
    """Joint positions, and how far the object, or the tip, is from the desired pose.

    Attributes:
        q: (n,) rad, m. miss: (m, rad), of the arm that is furthest.
    """

    q: Array
    miss: tuple[float, float]

    @property
    def reached(self) -> bool:
        """Whether the pose is met."""
        return self.miss[0] <= MISS_M and self.miss[1] <= MISS_RAD


def arm_of(reference: str, tip: str | None = None) -> Arm:
    """An arm by the name of a robot, or from a URDF or an MJCF file.

    Args:
        reference: as `robots.resolve_urdf` takes it.
        tip: a frame; None: the only end of the robot.

    Raises:
        ModelError: no such robot or frame; or the robot has several ends and no tip is given.
    """
    path, folders = robots.resolve_urdf(reference)
    name = "".join(c if c.isalnum() else "_" for c in path.stem)
    model, _ = robots.load_robot(path, tip, package_dirs=folders)
    if tip is None:
        ends = robots.ends_of(model)
        if len(ends) != 1:
            raise ModelError(
                f"{reference} has {len(ends)} ends: {', '.join(ends)}; name the frame that holds "
                "the object with --tip"
            )
        tip = ends[0]
    return Arm.from_urdf(model, name=name, tip=tip)


def chain_of(scenario: Scenario) -> tuple[ClosedChain, Array, pin.SE3]:
    """Chain, posture (n,) and object pose of a scenario, before contacts move any of it."""
    chain = build_chain(scenario)
    posture = posture_of(scenario, chain)
    return chain, posture, given_pose(scenario, chain, posture)


def numbers(kind: str, text: str) -> Array:
    """A vector that a person typed: "0.4, 0, 30 cm" or "[180 deg, 0, 0]".

    Args:
        kind: "xyz", "rpy" or "posture". text: numbers in SI, or with units.

    Raises:
        InvalidInputError: with what was expected.
    """
    import yaml

    try:
        items = yaml.safe_load(f"[{text.strip().strip('[]')}]")
        return np.array(VECTORS[kind].validate_python(items), dtype=float)
    except ValidationError as error:
        raise InvalidInputError(f"{kind} {text!r}: {error.errors()[0]['msg']}") from error
    except yaml.YAMLError as error:
        raise InvalidInputError(f"{kind} {text!r}: expected numbers with commas between") from error


def place(text: str) -> Array:
    """(3,) m, a place that a person typed.

    Raises:
        InvalidInputError: it is none, or further away than any arm reaches.
    """
    xyz = numbers("xyz", text)
    if np.abs(xyz).max() > FARTHEST_M:
        as_mm = ", ".join(f"{x:g} mm" for x in xyz)
        raise InvalidInputError(
            f"xyz {text!r}: {np.abs(xyz).max():g} m, and plain numbers are metres; in millimetres "
            f"write {as_mm!r}"
        )
    return xyz


def degrees(chain: ClosedChain, q: Array) -> list[str]:
    """A sentence where a posture outside the limits is within them if its angles are degrees.

    Args:
        chain: the arms. q: (n,) joint positions (rad, m).
    """
    slide = np.concatenate([sliding(arm.model) for arm in chain.arms])
    turned = np.where(slide, q, np.radians(q))
    if not outside_limits(chain, q) or outside_limits(chain, turned):
        return []
    units = ", ".join(f"{x:g}" if s else f"{x:g} deg" for x, s in zip(q, slide, strict=True))
    return [f"plain numbers are radians, and these look like degrees: write '{units}'"]


def solve(chain: ClosedChain, X_WO: pin.SE3, start: Array, seed: int | None = None) -> Posture:
    """Joint positions within limits that put the object at the desired pose, or nearest to it.

    Args:
        chain: the arms; without an object their tip. X_WO: the desired pose.
        start: (n,) where to look first, before random postures between the limits.
        seed: seed of these; None: 0. If it is given they come first, and may find other postures.
    """
    missed = []
    random = robots.random_configurations(chain.model, TRIES, seed or 0)
    for q in (start, *random) if seed is None else (*random, start):
        try:
            found = reach(chain, q, X_WO)
        except ModelError:  # it circles about a pose out of reach
            continue
        posture = Posture(found, _miss(chain, found, X_WO))
        if posture.reached:
            return posture
        missed.append(posture)
    if not missed:
        raise ModelError(
            f"no posture comes near {np.round(X_WO.translation, 4).tolist()} m; is it within the "
            "arms' reach?"
        )
    return min(missed, key=lambda posture: sum(posture.miss))


def _miss(chain: ClosedChain, q: Array, X_WO: pin.SE3) -> tuple[float, float]:
    """Largest errors of the grasps at a posture.

    Args:
        chain: model of the arms. q: (n,) joint positions. X_WO: pose of the object.

    Returns:
        Distance (m) and angle (rad) between the object and where the arms hold it.
    """
    pin.forwardKinematics(chain.model, chain.data, q)
    away = []
    for tip, grasp in zip(chain.tip_poses(), chain.grasps, strict=True):
        X = tip * grasp.X_TO
        shift, turn = map(norm, np.split(pose_error(X_WO, X), 2))
        # what a loose grasp permits is no miss
        away.append((shift, turn) if grasp.is_rigid else (norm(grasp.miss(tip, X_WO)), 0.0))
    shift, turn = np.max(away, axis=0).tolist()
    return shift, turn


def rest(chain: ClosedChain) -> Array:
    """(n,) the middle between the joints' limits, 0 where there are none."""
    low, high = position_limits(chain.model)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(0.5 * (low + high), posinf=0.0, neginf=0.0)


def as_dict(chain: ClosedChain, q: Array) -> Json:
    """JSON-able: joints and poses, (4, 4) in the world."""
    X = object_pose(chain, q)
    tips = zip(chain.arms, chain.tip_poses(), strict=True)
    return {
        "posture": dict(zip(chain.joint_names, map(float, q), strict=True)),
        "tips": {arm.name: X_WT.homogeneous.tolist() for arm, X_WT in tips},
        "object": X.homogeneous.tolist(),
    }


def pose_lines(chain: ClosedChain, q: Array) -> list[str]:
    """Lines with postures and pose of the object, in the form of a scenario file."""
    lines = []
    for arm, s in zip(chain.arms, chain.slices, strict=True):
        values = ", ".join(
            f"{x:.6f}" if slides else f"{np.rad2deg(x):.4f} deg"
            for x, slides in zip(q[s], sliding(arm.model), strict=True)
        )
        lines.append(f"{arm.name} posture: [{values}]   # {', '.join(joint_names(arm.model))}")
    pin.forwardKinematics(chain.model, chain.data, q)
    for arm, X in zip(chain.arms, chain.tip_poses(), strict=True):
        lines.append(f"{arm.name} {arm.tip}: {pose_text(X)}")
    if chain.payload is not None:
        lines.append(f"object pose: {pose_text(object_pose(chain, q))}")
    return lines


def pose_text(X: pin.SE3) -> str:
    """A pose as a scenario file writes it (m, deg)."""
    angles = np.rad2deg(pin.rpy.matrixToRpy(X.rotation))
    return f"{{xyz: [{_listed(X.translation, 6)}], rpy: [{_listed(angles, 4, ' deg')}]}}"


def _listed(values: Sequence[float] | Array, digits: int, unit: str = "") -> str:
    return ", ".join(
        f"{round(float(x), digits) + 0.0:g}{unit}" if abs(x) < 1e-9 else f"{x:.{digits}f}{unit}"
        for x in values
    )


#: radius of the stylus' ball, and how far it is from the tip
BALL_M = 0.008
LENGTH_M = 0.08
#: random postures that are compared, and built until one is sound
POSTURES = 600
TRIED = 12


@dataclass(frozen=True)
class Press:
    """Along which axis of the tip's frame a robot presses, and how hard.

    Attributes:
        axis: (3,) unit. force: N.
    """

    axis: tuple[float, float, float]
    force: float

    def __str__(self) -> str:
        k = np.abs(self.axis).argmax()
        sign = "-" if self.axis[k] < 0.0 else ""
        return f"{sign}{'xyz'[k]}"

    @classmethod
    def parse(cls, text: str) -> Press:
        """Parse a press in the form "Z=15" or "-X=5".

        Raises:
            InvalidInputError: the text has another form.
        """
        name, _, number = text.replace(" ", "").partition("=")
        letter = name.lstrip("+-").upper()
        try:
            force = float(number.removesuffix("N"))
        except ValueError:
            force = -1.0
        if letter not in ("X", "Y", "Z") or not 0.0 < force < np.inf:
            raise InvalidInputError(
                f"press {text!r}: expected an axis of the tip and newtons, such as Z=15 or -X=5"
            )
        sign = -1.0 if name.startswith("-") else 1.0
        x, y, z = (sign if one == letter else 0.0 for one in "XYZ")
        return cls((x, y, z), force)


def draft(robot: str, arm: Arm, press: Press, posture: Array | None, target: Path) -> str:
    """The text of a scenario without findings of `preflight` and whose run is OK.

    Args:
        robot: as the user called it. arm: the same. press: how.
        posture: (n,) where it starts; None: a posture away from limits and singular ones, with
            the stylus pointing down as far as the arm lets it.
        target: file of the text, which relative paths begin from.

    Raises:
        ScenarioError: no posture is found, or the one given is refused; with the reason.
    """
    reasons: list[str] = []
    for q in [posture] if posture is not None else _postures(arm, press):
        try:
            text = _text(robot, arm, press, q)
            scenario = parse_scenario(text, target)
            found = [one.text for one in preflight(build_rig(scenario))]
            complaints = found or _rehearsed(scenario)
            if not complaints:
                return text
        except OscContactError as error:
            complaints = [str(error)]
        reasons.append(complaints[0])
    if posture is not None:
        raise ScenarioError(
            f"in the posture given '{arm.tip}' of {robot} cannot press {press.force:g} N along its "
            f"{press}: {reasons[0]}; give another posture, or none to have one sought"
        )
    raise ScenarioError(
        f"no posture of {robot} was found in which '{arm.tip}' can press {press.force:g} N along "
        f"its {press}; the last one: {reasons[-1] if reasons else 'no candidate'}; "
        "give --posture, or press less"
    )


def _rehearsed(scenario: Scenario) -> list[str]:
    """Sentences on ticks or a verdict that are not OK in a run of the scenario."""
    verdict = metrics(run(scenario))
    counts = [f"{count} ticks {word}" for word, count in verdict["status"].items() if word != "ok"]
    bad = [text for text in counts if not text.startswith("0 ")]
    return bad if verdict["task"]["word"] == "OK" else [f"a run ends {verdict['task']['word']}"]


def _postures(arm: Arm, press: Press) -> Iterator[Array]:
    """Random postures between the limits, the best first."""
    model = arm.model
    data = arm.model.createData()
    tip = robots.frame_id(model, arm.tip)
    axis = np.array(press.axis)
    low, high = position_limits(model)
    limits = np.minimum(model.upperEffortLimit, 1e6)
    candidates = []
    scores = []
    for q in robots.random_configurations(model, POSTURES):
        turned = (q + np.pi) % (2 * np.pi) - np.pi  # angles between ∓π, where limits allow it
        q = np.where((turned >= low) & (turned <= high), turned, q)
        candidates.append(q)
        pin.forwardKinematics(model, data, q)
        X = pin.updateFramePlacement(model, data, tip)
        J, M = _jacobian(model, data, q, tip)
        down = X.rotation @ axis
        sizes = np.linalg.svd(np.linalg.solve(np.linalg.cholesky(M), J.T), compute_uv=False)
        load = pin.computeGeneralizedGravity(model, data, q) - J.T @ (press.force * down)
        strain = np.abs(load / limits).max()
        with np.errstate(invalid="ignore"):
            room = np.minimum(q - low, high - q) / np.minimum(high - low, 2 * np.pi)
        margin = np.nanmin(np.where(np.isfinite(room), room, 0.5))
        rank = min(3, model.nv)
        score = sizes[rank - 1] / max(sizes[0], 1e-12) + min(margin, 0.15) / 0.15 - 0.5 * down[2]
        score += 0.5 * min(X.translation[2], 0.1) / 0.1 - max(0.0, strain - 0.4) * 5.0
        scores.append(score)
    for k in np.argsort(scores)[::-1][:TRIED]:
        yield candidates[k]


class _Slide(NamedTuple):
    """Place of the stylus and motion of its ball along the plate.

    Attributes:
        joints: names of the arm's joints, for a comment. grasp: pose of the stylus in the tip.
        point: (3,) lowest point of the ball (m). down: (3,) unit axis of the stylus.
        along: (3,) direction of the motion in the plate. travel: its amplitude (mm).
    """

    joints: str
    grasp: pin.SE3
    point: Array
    down: Array
    along: Array
    travel: float


def _slide(arm: Arm, press: Press, q: Array) -> _Slide:
    """Place the stylus in a posture q (n,) and choose the motion along the plate.

    Raises:
        InvalidInputError: q has not one number for each joint.
    """
    model = arm.model
    data = arm.model.createData()
    joints = ", ".join(joint_names(model))
    if len(q) != model.nv:
        raise InvalidInputError(f"posture: {len(q)} numbers for {model.nv} joints: {joints}")
    pin.forwardKinematics(model, data, q)
    tip = robots.frame_id(model, arm.tip)
    X_WT = pin.updateFramePlacement(model, data, tip)
    axis = np.array(press.axis)
    down = X_WT.rotation @ axis
    return _Slide(
        joints=joints,
        grasp=pin.SE3(triad(axis), np.zeros(3)),  # the stylus points along the axis
        point=X_WT.translation + (LENGTH_M + BALL_M) * down,
        down=down,
        along=_tangent(model, data, q, tip, down),
        travel=min(20.0, 1e3 * 0.05 * norm(X_WT.translation)),
    )


def _text(robot: str, arm: Arm, press: Press, q: Array) -> str:
    """Text of a scenario in which an arm presses a stylus on a plate.

    Args:
        robot: name or file of the robot. arm: its arm. press: force and axis. q: (n,) posture.
    """
    joints, grasp, point, down, along, travel = _slide(arm, press, q)
    about = f"{robot} presses {press.force:g} N with a stylus along {press} of {arm.tip}"
    return f"""\
# {robot} presses a stylus on a plate with {press.force:g} N and slides along it.
# A quantity is a number in SI or a string with a unit; docs/scenario.md has every key.
name: {arm.name}_press
description: {_quoted(f"{about}, and slides")}

arms:
  - name: {arm.name}
    urdf: {_quoted(_reference(robot))}
    tip: {_quoted(arm.tip)}                    # the frame that carries the stylus
    wrist_sensor: {_quoted(arm.tip)}           # where force and torque are measured
    # {joints}
    posture: [{", ".join(f"{x:.6f}" for x in q)}]   # rad, m

object:
  urdf: stylus.urdf                   # 60 g, 80 mm long, a ball of 8 mm radius at its end
                                      # no pose: it is where the posture puts it

grasps:                               # pose of the stylus in the frame of the tip
  {arm.name}: {pose_text(grasp)}

contacts:
  - name: ball
    type: vertex_on_face
    vertex: [0, 0, 80 mm]             # centre of the ball, in the frame of the stylus
    radius: 8 mm
    face:                             # the plate: a point of it, and the normal that points out
      urdf: face.urdf
      point: [{", ".join(f"{x:.6f}" for x in point)}]
      normal: [{", ".join(f"{x:.6f}" for x in _unnoisy(-down))}]

force:                                # what the ball presses with
  ball:
    - {{type: constant, value: {0.2 * press.force:g} N}}
    - {{type: minimum_jerk, value: {0.8 * press.force:g} N, start: 0.1 s, duration: 0.6 s}}

motion:                               # to and fro along the plate
  - kind: linear
    direction: [{", ".join(f"{x:.6f}" for x in _unnoisy(along))}]
    signals: [{{type: sine, amplitude: {travel:.3g} mm, frequency: 0.25 Hz, ramp: 1 s}}]

gains:                                # they serve every mass
  motion: {{frequency: 3.2 Hz, damping_ratio: 1}}
  force: {{bandwidth: 5 Hz, damping_ratio: 0.7}}

control: {{rate: 1 kHz}}
plant: {{type: mujoco, step: 0.25 ms}}
duration: 4 s
"""


def _quoted(text: str) -> str:
    """A text as YAML, in quotation marks where it would be read as something else."""
    import yaml

    try:
        if yaml.safe_load(text) == text:
            return text
    except yaml.YAMLError:
        pass
    return json.dumps(text, ensure_ascii=False)


def _unnoisy(direction: Array) -> Array:
    """The unit vector (3,) without components that the rounding of the posture makes."""
    kept = np.where(np.abs(direction) < 1e-5, 0.0, direction)
    return kept / norm(kept)


def _reference(robot: str) -> str:
    """Name or absolute path of a robot for a scenario file."""
    return str(Path(robot).resolve()) if Path(robot).is_file() else robot


def _tangent(model: pin.Model, data: pin.Data, q: Array, tip: int, down: Array) -> Array:
    """The direction (3,) along the plate in which the tip moves most easily."""
    J, M = _jacobian(model, data, q, tip)
    P = np.eye(3) - np.outer(down, down)
    along = np.linalg.eigh(P @ J @ np.linalg.solve(M, J.T) @ P)[1][:, -1]
    return along * np.sign(along[np.abs(along).argmax()])


def _jacobian(model: pin.Model, data: pin.Data, q: Array, tip: int) -> tuple[Array, Array]:
    """J (3, n) of the tip in the world, M (n, n)."""
    J = pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)
    return columns_of(J)[:3], np.array(pin.crba(model, data, q))

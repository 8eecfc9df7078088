"""Forward and inverse kinematics of arms and scenarios for the command line, within joint limits.

Also the draft of a first scenario for any arm, which presses a stylus on a plate and slides along
it.
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

TRIES = 40  #: number of random postures from which the search for a pose starts
MISS_M = 1e-6  #: largest distance from a pose that counts as reached (m)
MISS_RAD = 1e-5  #: largest angle from a pose that counts as reached (rad)
FARTHEST_M = 20.0  #: largest coordinate of a place that is taken for metres (m)
#: Vectors that are typed on the command line, with their types.
VECTORS: dict[str, TypeAdapter[Any]] = {
    "xyz": TypeAdapter(Vec3),
    "rpy": TypeAdapter(AngleVec3),
    "posture": TypeAdapter(tuple[JointValue, ...]),
}


@dataclass(frozen=True)
class Posture:
    """Joint positions, and the deviation of the object, or the tip, from the desired pose.

    Attributes:
        q: (n,) joint positions (rad, m).
        miss: distance (m) and angle (rad) from the desired pose, each the largest of all arms.
    """

    q: Array
    miss: tuple[float, float]

    @property
    def reached(self) -> bool:
        """Whether the deviation is below `MISS_M` and `MISS_RAD`."""
        return self.miss[0] <= MISS_M and self.miss[1] <= MISS_RAD


def arm_of(reference: str, tip: str | None = None) -> Arm:
    """Load an arm by the name of a robot, or from a URDF or an MJCF file.

    Args:
        reference: name or file, as for `robots.resolve_urdf`.
        tip: frame that holds the object; None: the only end of the robot.

    Raises:
        ModelError: there is no such robot or frame, or the robot has several ends and no tip is
            given.
    """
    path, folders = robots.resolve_urdf(reference)
    name = "".join(letter if letter.isalnum() else "_" for letter in path.stem)
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
    """Chain, posture (n,) and object pose of a scenario as given, not moved to its contacts."""
    chain = build_chain(scenario)
    posture = posture_of(scenario, chain)
    return chain, posture, given_pose(scenario, chain, posture)


def numbers(kind: str, text: str) -> Array:
    """Parse a vector from the command line, such as "0.4, 0, 30 cm" or "[180 deg, 0, 0]".

    Args:
        kind: key of `VECTORS`: "xyz", "rpy" or "posture".
        text: numbers in SI units, or with units.

    Raises:
        InvalidInputError: the text is not such a vector.
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
    """Parse a position (3,) from the command line (m).

    Args:
        text: three numbers in m, or with units.

    Raises:
        InvalidInputError: the text is not a position, or a coordinate is so large that it is
            probably in mm.
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
    """Hint that a posture outside the limits is within them if its angles are degrees.

    Args:
        chain: arms.
        q: (n,) joint positions (rad, m).

    Returns:
        A sentence, or no sentence.
    """
    slides = np.concatenate([sliding(arm.model) for arm in chain.arms])
    from_degrees = np.where(slides, q, np.radians(q))
    if not outside_limits(chain, q) or outside_limits(chain, from_degrees):
        return []
    with_units = ", ".join(
        f"{x:g}" if is_sliding else f"{x:g} deg" for x, is_sliding in zip(q, slides, strict=True)
    )
    return [f"plain numbers are radians, and these look like degrees: write '{with_units}'"]


def solve(chain: ClosedChain, X_WO: pin.SE3, start: Array, seed: int | None = None) -> Posture:
    """Find joint positions within limits at which the object is at a pose, or nearest to it.

    Args:
        chain: arms; without an object the pose is that of their tip.
        X_WO: desired pose.
        start: (n,) joint positions from which the search starts, before random ones.
        seed: seed of the random postures; None: seed 0. If a seed is given, random postures come
            before `start`, so that another posture may be found.

    Raises:
        ModelError: no search converges.
    """
    postures = []
    random = robots.random_configurations(chain.model, TRIES, seed or 0)
    for q in (start, *random) if seed is None else (*random, start):
        try:
            q_near = reach(chain, q, X_WO)
        except ModelError:  # the iteration does not converge for a pose out of reach
            continue
        posture = Posture(q_near, _miss(chain, q_near, X_WO))
        if posture.reached:
            return posture
        postures.append(posture)
    if not postures:
        raise ModelError(
            f"no posture comes near {np.round(X_WO.translation, 4).tolist()} m; is it within the "
            "arms' reach?"
        )
    return min(postures, key=lambda posture: sum(posture.miss))


def _miss(chain: ClosedChain, q: Array, X_WO: pin.SE3) -> tuple[float, float]:
    """Largest errors of the grasps at a posture.

    Args:
        chain: model of the arms.
        q: (n,) joint positions.
        X_WO: pose of the object.

    Returns:
        Largest distance (m) and angle (rad) between the pose and the pose in an arm's grasp. The
        motions that a loose grasp permits do not count.
    """
    pin.forwardKinematics(chain.model, chain.data, q)
    misses = []
    for X_WT, grasp in zip(chain.tip_poses(), chain.grasps, strict=True):
        if grasp.is_rigid:
            displacement, rotation = np.split(pose_error(X_WO, X_WT * grasp.X_TO), 2)
            misses.append((norm(displacement), norm(rotation)))
        else:
            misses.append((norm(grasp.miss(X_WT, X_WO)), 0.0))
    distance, angle = np.max(misses, axis=0).tolist()
    return distance, angle


def rest(chain: ClosedChain) -> Array:
    """Joint positions (n,) in the middle between the limits, 0 for joints without limits."""
    low, high = position_limits(chain.model)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(0.5 * (low + high), posinf=0.0, neginf=0.0)


def as_dict(chain: ClosedChain, q: Array) -> Json:
    """Posture and poses as JSON data: joint positions by name, poses (4, 4) of tips and object.

    Args:
        chain: arms whose forward kinematics have been computed at q.
        q: (n,) joint positions.
    """
    X = object_pose(chain, q)
    tips = zip(chain.arms, chain.tip_poses(), strict=True)
    return {
        "posture": dict(zip(chain.joint_names, map(float, q), strict=True)),
        "tips": {arm.name: X_WT.homogeneous.tolist() for arm, X_WT in tips},
        "object": X.homogeneous.tolist(),
    }


def pose_lines(chain: ClosedChain, q: Array) -> list[str]:
    """Lines with postures, tips and pose of the object, in the form of a scenario file.

    Args:
        chain: arms.
        q: (n,) joint positions (rad, m).
    """
    lines = []
    for arm, joints in zip(chain.arms, chain.slices, strict=True):
        values = ", ".join(
            f"{x:.6f}" if slides else f"{np.rad2deg(x):.4f} deg"
            for x, slides in zip(q[joints], sliding(arm.model), strict=True)
        )
        lines.append(f"{arm.name} posture: [{values}]   # {', '.join(joint_names(arm.model))}")
    pin.forwardKinematics(chain.model, chain.data, q)
    for arm, X in zip(chain.arms, chain.tip_poses(), strict=True):
        lines.append(f"{arm.name} {arm.tip}: {pose_text(X)}")
    if chain.payload is not None:
        lines.append(f"object pose: {pose_text(object_pose(chain, q))}")
    return lines


def pose_text(X: pin.SE3) -> str:
    """Write a pose as in a scenario file, with position (m) and roll, pitch, yaw (deg)."""
    angles = np.rad2deg(pin.rpy.matrixToRpy(X.rotation))
    return (
        f"{{xyz: [{_numbers_text(X.translation, 6)}], rpy: [{_numbers_text(angles, 4, ' deg')}]}}"
    )


def _numbers_text(values: Sequence[float] | Array, digits: int, unit: str = "") -> str:
    """Write numbers with commas between; rounding errors about zero become 0, never −0.

    Args:
        values: numbers.
        digits: number of decimals.
        unit: unit after each number, with its space.
    """
    return ", ".join(
        f"{round(float(x), digits) + 0.0:g}{unit}" if abs(x) < 1e-9 else f"{x:.{digits}f}{unit}"
        for x in values
    )


BALL_M = 0.008  #: radius of the ball of the stylus (m)
LENGTH_M = 0.08  #: distance of the ball's centre from the tip (m)
POSTURES = 600  #: number of random postures that are compared
TRIED = 12  #: number of the best postures that are tried until one has no findings


@dataclass(frozen=True)
class Press:
    """Axis along which a robot presses, and the force.

    Attributes:
        axis: (3,) unit vector in the tip's frame.
        force: desired force (N).
    """

    axis: tuple[float, float, float]
    force: float

    def __str__(self) -> str:
        """Return the axis in the form of the command line, such as z or -x."""
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
        x, y, z = (sign if axis == letter else 0.0 for axis in "XYZ")
        return cls((x, y, z), force)


def draft(robot: str, arm: Arm, press: Press, posture: Array | None, target: Path) -> str:
    """Write a scenario in which a robot presses, without findings of `preflight`, and run it.

    Args:
        robot: name or file of the robot, as on the command line.
        arm: arm of the robot.
        press: axis and force.
        posture: (n,) posture at the start; None: a posture is searched that is far from joint
            limits and singular postures, with the stylus pointing down as far as possible.
        target: file of the text, to whose folder relative paths refer.

    Returns:
        Text of the scenario, whose run is OK.

    Raises:
        ScenarioError: no posture is found, or the given posture is refused.
    """
    reasons: list[str] = []
    for q in [posture] if posture is not None else _postures(arm, press):
        try:
            text = _text(robot, arm, press, q)
            scenario = parse_scenario(text, target)
            complaints = [finding.text for finding in preflight(build_rig(scenario))]
            complaints = complaints or _complaints_of_run(scenario)
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


def _complaints_of_run(scenario: Scenario) -> list[str]:
    """Run a scenario; return sentences on ticks or a verdict that are not OK."""
    verdict = metrics(run(scenario))
    word = verdict["task"]["word"]
    if word != "OK":
        return [f"a run ends {word}"]
    return [
        f"{count} ticks {status}"
        for status, count in verdict["status"].items()
        if status != "ok" and count > 0
    ]


def _postures(arm: Arm, press: Press) -> Iterator[Array]:
    """Yield the best of many random postures (n,) between the joint limits, the best first.

    Args:
        arm: arm of the robot.
        press: axis and force.
    """
    model = arm.model
    low, high = position_limits(model)
    candidates = []
    scores = []
    for q in robots.random_configurations(model, POSTURES):
        wrapped = (q + np.pi) % (2 * np.pi) - np.pi  # angles between −π and π
        q = np.where((wrapped >= low) & (wrapped <= high), wrapped, q)
        candidates.append(q)
        scores.append(_score(arm, press, q))
    for k in np.argsort(scores)[::-1][:TRIED]:
        yield candidates[k]


def _score(arm: Arm, press: Press, q: Array) -> float:
    """Suitability of a posture for pressing down: a heuristic without unit, larger is better.

    The sum of: ratio of the least to the largest mobility of the tip, 0 … 1, against singular
    postures; distance from the joint limits, up to 1 at 15 % of the range; direction of the stylus,
    0.5 if it points down; height of the tip, up to 0.5 at 0.1 m; and a penalty for motor torques
    above 40 % of the limits.

    Args:
        arm: arm of the robot.
        press: axis and force.
        q: (n,) joint positions (rad, m).
    """
    model = arm.model
    data = model.createData()
    tip = robots.frame_id(model, arm.tip)
    low, high = position_limits(model)
    pin.forwardKinematics(model, data, q)
    X = pin.updateFramePlacement(model, data, tip)
    J, M = _jacobian(model, data, q, tip)
    down = X.rotation @ np.array(press.axis)
    # singular values of J L⁻ᵀ with M = L Lᵀ: speeds of the tip for a unit of kinetic energy
    sizes = np.linalg.svd(np.linalg.solve(np.linalg.cholesky(M), J.T), compute_uv=False)
    rank = min(3, model.nv)
    mobility_ratio = sizes[rank - 1] / max(sizes[0], 1e-12)
    with np.errstate(invalid="ignore"):
        distances = np.minimum(q - low, high - q) / np.minimum(high - low, 2 * np.pi)
    margin = np.nanmin(np.where(np.isfinite(distances), distances, 0.5))
    limits = np.minimum(model.upperEffortLimit, 1e6)
    load = pin.computeGeneralizedGravity(model, data, q) - J.T @ (press.force * down)
    strain = np.abs(load / limits).max()
    score = mobility_ratio + min(margin, 0.15) / 0.15 - 0.5 * down[2]
    score += 0.5 * min(X.translation[2], 0.1) / 0.1 - max(0.0, strain - 0.4) * 5.0
    return float(score)


class _Slide(NamedTuple):
    """Place of the stylus and motion of its ball along the plate.

    Attributes:
        joints: names of the arm's joints, for a comment.
        grasp: pose of the stylus in the tip.
        point: (3,) lowest point of the ball (m).
        down: (3,) unit axis of the stylus.
        along: (3,) direction of the motion in the plate.
        travel: its amplitude (mm).
    """

    joints: str
    grasp: pin.SE3
    point: Array
    down: Array
    along: Array
    travel: float


def _slide(arm: Arm, press: Press, q: Array) -> _Slide:
    """Place the stylus in a posture q (n,) and choose the motion along the plate.

    Args:
        arm: arm with the stylus.
        press: axis of the tip and force.
        q: (n,) posture (rad, m).

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
        robot: name or file of the robot.
        arm: its arm.
        press: force and axis.
        q: (n,) posture.
    """
    joints, grasp, point, down, along, travel = _slide(arm, press, q)
    about = f"{robot} presses {press.force:g} N with a stylus along {press} of {arm.tip}"
    return f"""\
# {robot} presses a stylus on a plate with {press.force:g} N and slides along it.
# A quantity is a number in SI or a string with a unit; docs/scenario.md has every key.
name: {arm.name}_press
description: {_quote(f"{about}, and slides")}

arms:
  - name: {arm.name}
    urdf: {_quote(_reference(robot))}
    tip: {_quote(arm.tip)}                    # the frame that carries the stylus
    wrist_sensor: {_quote(arm.tip)}           # where force and torque are measured
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


def _quote(text: str) -> str:
    """Write a text as YAML, in quotation marks if YAML would read it as another value."""
    import yaml

    try:
        if yaml.safe_load(text) == text:
            return text
    except yaml.YAMLError:
        pass
    return json.dumps(text, ensure_ascii=False)


def _unnoisy(direction: Array) -> Array:
    """Unit vector (3,) without components below 1e-5, which come from rounding the posture."""
    rounded = np.where(np.abs(direction) < 1e-5, 0.0, direction)
    return rounded / norm(rounded)


def _reference(robot: str) -> str:
    """Name or absolute path of a robot for a scenario file."""
    return str(Path(robot).resolve()) if Path(robot).is_file() else robot


def _tangent(model: pin.Model, data: pin.Data, q: Array, tip: int, down: Array) -> Array:
    """Direction (3,) along the plate with the largest mobility of the tip, a unit vector.

    It is the eigenvector of P J M⁻¹Jᵀ P with the largest eigenvalue, P = 1 − down downᵀ.

    Args:
        model, data: model of the arm.
        q: (n,) joint positions.
        tip: index of the tip's frame.
        down: (3,) normal of the plate, world axes.
    """
    J, M = _jacobian(model, data, q, tip)
    P = np.eye(3) - np.outer(down, down)
    along = np.linalg.eigh(P @ J @ np.linalg.solve(M, J.T) @ P)[1][:, -1]
    return along * np.sign(along[np.abs(along).argmax()])


def _jacobian(model: pin.Model, data: pin.Data, q: Array, tip: int) -> tuple[Array, Array]:
    """Linear Jacobian J (3, n) of the tip in world axes, and inertia matrix M (n, n).

    Args:
        model, data: model of the arm.
        q: (n,) joint positions.
        tip: index of the tip's frame.
    """
    J = pin.computeFrameJacobian(model, data, q, tip, pin.LOCAL_WORLD_ALIGNED)
    return columns_of(J)[:3], np.array(pin.crba(model, data, q))

"""Forward and inverse kinematics of arms and scenarios, within joint limits, for people."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from pydantic import TypeAdapter, ValidationError

from osc_contact import robots
from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.assembly import object_pose, reach
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.robots.model import joint_names, position_limits, sliding
from osc_contact.runs.rig import build_chain, given_pose, posture_of
from osc_contact.scenarios.quantities import AngleVec3, JointValue, Vec3
from osc_contact.scenarios.schema import Scenario
from osc_contact.spatial import Array, norm

TRIES = 40  #: random postures from which a pose is sought, after the given one
#: a pose that is missed by less is reached
MISS_M = 1e-6
MISS_RAD = 1e-5
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
        reference: as `robots.locate` takes it.
        tip: a frame; None: the only end of the robot.

    Raises:
        ModelError: no such robot or frame; or the robot has several ends and no tip is given.
    """
    path, folders = robots.locate(reference)
    name = "".join(c if c.isalnum() else "_" for c in path.stem)
    model = robots.load_robot(path, tip, package_dirs=folders)
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


def solve(chain: ClosedChain, X_WO: pin.SE3, start: Array, seed: int | None = None) -> Posture:
    """Joint positions within limits that put the object at the desired pose, or nearest to it.

    Args:
        chain: the arms; without an object their tip. X_WO: the desired pose.
        start: (n,) where to look first, before random postures between the limits.
        seed: of these; None: 0. If it is given they come first, and may find other postures.
    """
    best: Posture | None = None
    random = robots.random_configurations(chain.model, TRIES, seed or 0)
    for q in (start, *random) if seed is None else (*random, start):
        try:
            found = reach(chain, q, X_WO)
        except ModelError:  # it circles about a pose out of reach
            continue
        posture = Posture(found, _miss(chain, found, X_WO))
        if best is None or posture.reached or sum(posture.miss) < sum(best.miss):
            best = posture
        if best.reached:
            return best
    if best is None:
        raise ModelError(
            f"no posture comes near {np.round(X_WO.translation, 4).tolist()} m; is it within the "
            "arms' reach?"
        )
    return best


def _miss(chain: ClosedChain, q: Array, X_WO: pin.SE3) -> tuple[float, float]:
    pin.forwardKinematics(chain.model, chain.data, q)
    away = []
    for tip, grasp in zip(chain.tip_poses(), chain.grasps, strict=True):
        X = tip * grasp.X_TO
        turn = norm(pin.log3(X.rotation.T @ X_WO.rotation))
        shift = norm(X.translation - X_WO.translation)
        # what a loose grasp permits is no miss
        away.append((shift, turn) if grasp.is_rigid else (norm(grasp.miss(tip, X_WO)), 0.0))
    shift, turn = np.max(away, axis=0).tolist()
    return shift, turn


def rest(chain: ClosedChain) -> Array:
    """(n,) the middle between the joints' limits, 0 where there are none."""
    low, high = position_limits(chain.model)
    ends = np.isfinite(low) & np.isfinite(high)
    with np.errstate(invalid="ignore"):
        return np.where(ends, 0.5 * (low + high), 0.0)


def as_dict(chain: ClosedChain, q: Array) -> dict[str, Any]:
    """JSON-able: joints and poses, (4, 4) in the world."""
    X = object_pose(chain, q)
    tips = zip(chain.arms, chain.tip_poses(), strict=True)
    return {
        "posture": dict(zip(chain.joint_names, map(float, q), strict=True)),
        "tips": {arm.name: X_WT.homogeneous.tolist() for arm, X_WT in tips},
        "object": X.homogeneous.tolist(),
    }


def pose_lines(chain: ClosedChain, q: Array) -> list[str]:
    """Where posture and object are, as a scenario file writes it."""
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

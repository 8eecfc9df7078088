"""Plans that insert a peg into a hole that is some millimetres and degrees elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, atan2, hypot, radians, sqrt

import numpy as np
import pinocchio as pin

from osc_contact.contacts.insertion import CORNERS, Hole, Peg, pairs_between
from osc_contact.control.controller import Controller
from osc_contact.lab.tasks.insertion import Insertion, InsertionRobot
from osc_contact.loop.loop import run_loop
from osc_contact.plan.ends import after, at_rest, finished, lost, made, moved, pressed, when
from osc_contact.plan.motions import along, to, turn_to
from osc_contact.plan.plan import Outcome, Plan
from osc_contact.plan.sensed import Sensed
from osc_contact.plan.stage import Stage
from osc_contact.settings.control import JointFriction, PhaseSettings, SafetySettings
from osc_contact.settings.gains import ForceGains, Gains, MotionGains

LEAD = 3.5e-3  #: distance from the rims outward to the point where the corner touches the face (m)
HEIGHT = 6e-3  #: height of the corner above the face at the start (m)
LARGEST = 100.0  #: ceiling of the contact forces (N)
SEATED = 2e-3  #: largest distance of a seated peg from the bottom (m)
RESTING = 1e-3  #: speed below which a peg rests (m/s)
GAINS = Gains(
    motion=MotionGains(frequency=6.0, damping_ratio=1.0),
    force=ForceGains(integral=4.0, damping=0.0, brake=60.0, rise=0.25),
)
#: Metric of the motion filter. In the metric of its own inertia a light peg rotates by some degrees
#: for each millimetre that contacts do not permit; in this metric it is displaced.
METRIC = np.diag([0.2, 0.2, 0.2, 2.0, 2.0, 2.0])


@dataclass(frozen=True)
class Inserted:
    """Result of an insertion, from the truth.

    Attributes:
        success: True if the peg is seated within 2 mm of the bottom, tilted by no more than the
            clearance permits, and at rest.
        reason: why the plan did not reach its last stage; empty if it did.
        depth: depth of the tip in the hole (m). tilt: angle between the axes (rad).
        time: duration of the whole plan (s). tries: number of searches.
        largest_sum: largest norm of the sum of contact forces (N).
        largest_single: largest force of a single contact (N).
    """

    success: bool
    reason: str
    depth: float
    tilt: float
    time: float
    tries: int
    largest_sum: float
    largest_single: float


def insert(task: Insertion) -> Inserted:
    """Insert a square peg by `square_peg`, from the pose of `square_peg_start`."""
    plan = square_peg(task.peg, task.hole)
    robot = task.robot(square_peg_start(task.peg, task.hole))
    run_loop(robot, controller_of(task, plan, robot), plan)
    return judged(task, robot, plan)


def controller_of(task: Insertion, plan: Plan, robot: InsertionRobot) -> Controller:
    """Controller of the contacts that a plan names, with default safety but for its ceilings.

    Args:
        task: models of arm, peg and hole.
        plan: plan that names the contacts.
        robot: robot at rest at the start.
    """
    touch = pairs_between(task.peg, task.hole)
    return Controller(
        task.model,
        [touch[name] for name in plan.contacts],
        GAINS,
        B=METRIC,
        posture=robot.q_start,
        life=PhaseSettings(),
        in_contact=False,
        joint_friction=JointFriction(errors=True),
        safety=SafetySettings(contact_ceiling=LARGEST, wrist_ceiling=LARGEST),
    )


def judged(task: Insertion, robot: InsertionRobot, plan: Plan) -> Inserted:
    """Result of a plan that has ended.

    Args:
        task: true peg and hole.
        robot: judge of the run.
        plan: plan that has ended.
    """
    X = robot.in_hole()
    depth = float(X.translation[2])
    tilt = atan2(hypot(X.rotation[0, 2], X.rotation[1, 2]), X.rotation[2, 2])
    permitted = sqrt(2.0) * task.clearance / (task.hole.depth - SEATED)
    seated = abs(task.hole.depth - depth) < SEATED and tilt <= permitted
    resting = robot.speed() < RESTING
    return Inserted(
        success=plan.outcome is Outcome.DONE and seated and resting,
        reason=plan.reason,
        depth=depth,
        tilt=tilt,
        time=sum(verdict.duration for verdict in plan.verdicts),
        tries=sum(verdict.name == "find" for verdict in plan.verdicts),
        largest_sum=robot.largest_sum,
        largest_single=robot.largest_single,
    )


def square_peg_start(peg: Peg, hole: Hole) -> pin.SE3:
    """Pose of a square peg above the face, tilted so that one corner of its tip is lowest.

    Args:
        peg: peg, whose frame is that of the object. hole: hole at its believed pose.
    """
    rotation = pin.exp3(tilt_of(peg, hole) * np.array([1.0, -1.0, 0.0]) / sqrt(2.0))
    corner = 0.5 * peg.width * CORNERS["+x+y"]
    outward = 0.5 * hole.width + LEAD
    place = np.array([outward, outward, -HEIGHT]) - rotation @ corner
    return hole.pose * pin.SE3(rotation, place)


def tilt_of(peg: Peg, hole: Hole) -> float:
    """Tilt about a diagonal (rad), about 2° more than that at which a square peg would fall in.

    Args:
        peg: peg with its width. hole: hole with its width.
    """
    return sqrt(2.0) * (acos(peg.width / hole.width) + radians(2.0))


def square_peg(peg: Peg, hole: Hole) -> Plan:
    """Plan of a square peg, from `square_peg_start`.

    A corner is put down on the face and slides inward until it drops, two edges of the tip rest on
    two rims, two sides are pressed into the corner of the other rims, the peg rotates there until
    it is upright, and goes in. After a failure the peg is drawn back, and the search begins again.

    Args:
        peg: peg, whose frame is that of the object.
        hole: hole at its believed pose.
    """
    stages = [*_search_stages(peg, hole), *_entry_stages(peg, hole), *_last_stages(peg, hole)]
    return Plan(stages, largest=60.0, tries=3)


_CORNER = "+x+y"  #: corner of the tip that is lowest at the start
_LOWEST = f"corner {_CORNER} on face"  #: contact of this corner with the face


def _search_stages(peg: Peg, hole: Hole) -> list[Stage]:
    """Stages until a corner of the tip has dropped into the hole.

    Args:
        peg: peg with its width. hole: hole at its believed pose.
    """
    corner = 0.5 * peg.width * CORNERS[_CORNER]
    R = hole.pose.rotation
    into = R[:, 2]
    inward = -R @ CORNERS[_CORNER]
    return [
        Stage("weigh", until=after(0.4), within=1.0, tare=True),
        Stage("find", {_LOWEST: 6.0}, until=made(_LOWEST, lasting=0.15), within=4.0, fails="back"),
        Stage(
            "slide",
            {_LOWEST: 6.0},
            along(inward, 6e-3),
            until=moved(0.7e-3, into, point=corner),
            within=4.0,
            fails="back",
        ),
        Stage(
            "drop",
            {_LOWEST: 6.0},
            until=made(_LOWEST, lasting=0.15) & after(0.3),
            within=2.0,
            fails="back",
        ),
    ]


def _entry_stages(peg: Peg, hole: Hole) -> list[Stage]:
    """Stages from a dropped corner to the bottom of the hole.

    Args:
        peg: peg with its width. hole: hole at its believed pose.
    """
    corner = 0.5 * peg.width * CORNERS[_CORNER]
    into = hole.pose.rotation[:, 2]

    def depth(now: Sensed) -> float:
        """Depth of the tip's origin below the point where the corner touched the face (m)."""
        return float(into @ (now.X.translation - now.passed["find"].act(corner)))

    rims = ("side +x on rim +x", "side +y on rim +y")
    upright = {"side +x on rim +x, a": 2.0, "side +x on rim +x, b": 2.0, rims[1]: 4.0}
    seated = when(lambda now: depth(now) > hole.depth - 4e-3, "at the bottom")
    is_upright = (
        when(lambda now: depth(now) > 12e-3, "12 mm deep")
        | when(lambda now: now.t > 2.5 and depth(now) > 3e-3, "upright")
        | (lost(*upright, lasting=0.5) & when(lambda now: depth(now) > 2.5e-3, "in the mouth"))
        | after(6.0)
    )
    return [
        Stage(
            "two points",
            {"edge +y on rim -x": 3.5, "edge +x on rim -y": 3.5},
            until=after(0.4),
            within=2.0,
            fails="back",
        ),
        Stage(
            "corner",
            {rims[0]: 4.0, rims[1]: 4.0, "tip on face": 4.0},
            until=made(*rims, lasting=0.3) | (at_rest().lasting(0.5) & after(1.0)),
            within=4.0,
            unless=lost("tip on face", lasting=0.8) & after(1.5),
            fails="back",
        ),
        Stage(
            "upright",
            upright,
            turn_to([0, 0, 1], into, 0.5 * tilt_of(peg, hole)) & along(into, 5e-3, yields=6.0),
            until=is_upright,
            within=8.0,
            unless=lost(*upright, lasting=0.8),
            fails="back",
        ),
        Stage(
            "insert",
            {"hole": 0.0},
            along([0, 0, 1], 12e-3, axes="object", yields=10.0),
            until=(seated & pressed(6.0, into) & at_rest(2e-3, 0.05)).lasting(0.3),
            within=10.0,
            fails="back",
            places={"hole": lambda now: hole.found_at(now.X)},
            then="done",
        ),
    ]


def _last_stages(peg: Peg, hole: Hole) -> list[Stage]:
    """Stages after a failure, which lead back to the search, and the last stage of a success.

    Args:
        peg: peg with its width. hole: hole at its believed pose.
    """
    into = hole.pose.rotation[:, 2]
    start = square_peg_start(peg, hole)
    return [
        Stage("back", {}, along(-into, 20e-3, 30e-3), until=finished(), within=4.0, then="return"),
        Stage("return", {}, to(start, 30e-3, 0.5), until=finished(), within=8.0, then="find"),
        Stage("done", {"hole": 0.0}, until=after(0.1), within=1.0),
    ]

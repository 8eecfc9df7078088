"""Plan that inserts a peg into a hole that is some millimetres and degrees elsewhere.

The lowest point of the tilted tip is put down on the face and slides inward until it drops; the
edges of a square tip rest on two rims; two sides of the peg are pressed against the rims over which
the point dropped, which finds the hole; the peg rotates there until it is upright, and goes in.
After a failure it is drawn back, and the search begins again. A square peg is tilted about a
diagonal, so that its lowest point is a corner; a round peg about y.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import acos, atan2, cos, hypot, inf, nan, radians, sqrt

import numpy as np
import pinocchio as pin

from osc_contact.contacts.insertion import CORNERS, SIDES, Hole, Peg, pairs_between
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.control.controller import Controller
from osc_contact.control.status import Phase
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.lab.tasks.insertion import Insertion, InsertionRobot, TaskRobot
from osc_contact.loop.loop import run_loop
from osc_contact.plan.ends import (
    End,
    Watch,
    after,
    at_rest,
    finished,
    lost,
    made,
    pressed,
    when,
)
from osc_contact.plan.motions import Motion, along, through, to, turn_to
from osc_contact.plan.plan import Outcome, Plan
from osc_contact.plan.sensed import Sensed
from osc_contact.plan.stage import Stage
from osc_contact.settings.control import JointFriction, PhaseSettings, SafetySettings
from osc_contact.settings.gains import ForceGains, Gains, MotionGains
from osc_contact.spatial import Array

LEAD = 3.5e-3  #: distance from the rims outward to the point where the tip touches the face (m)
HEIGHT = 6e-3  #: height of the tip above the face at the start (m)
LARGEST = 100.0  #: ceiling of the contact forces (N)
SEATED = 2e-3  #: largest distance of a seated peg from the bottom (m)
PARALLEL = radians(0.5)  #: angle of two axes that are parallel (rad)
SLIDING = 6e-3  #: speed of the tip on the face (m/s)
STILL = 1e-3  #: speed below which a peg rests, by the truth (m/s)
RESTING = (2e-3, 0.05)  #: measured speeds below which a peg rests (m/s, rad/s)
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
        depth: depth of the tip in the hole (m).
        tilt: angle between the axes (rad).
        time: duration of the whole plan (s).
        tries: number of searches.
        largest_sum: largest norm of the sum of contact forces (N).
        largest_single: largest force of a single contact (N).
        mean_sum: mean norm of the sum of contact forces while anything touched (N); NaN of a
            recording that does not have it.
    """

    success: bool
    reason: str
    depth: float
    tilt: float
    time: float
    tries: int
    largest_sum: float
    largest_single: float
    mean_sum: float = nan


def insert(task: Insertion) -> Inserted:
    """Insert a peg by `peg_plan`, from the pose of `peg_start`.

    Args:
        task: insertion with its peg, hole and world.
    """
    robot, plan, controller = prepared(task)
    run_loop(robot, controller, plan)
    return judged(task, robot, plan)


def prepared(task: Insertion) -> tuple[InsertionRobot, Plan, Controller]:
    """Robot at its start, plan, and controller of an insertion.

    Args:
        task: insertion with its peg, hole and world.
    """
    plan = peg_plan(task.peg, task.hole)
    robot = task.robot(peg_start(task.peg, task.hole))
    return robot, plan, controller_of(task, plan, robot)


def controller_of(task: Insertion, plan: Plan, robot: InsertionRobot) -> Controller:
    """Controller of the contacts that a plan names.

    Args:
        task: models of arm, peg and hole.
        plan: plan that names the contacts.
        robot: robot at rest at the start.
    """
    return controller_for(task.model, pairs_between(task.peg, task.hole), plan, robot)


def controller_for(
    model: ClosedChain, pairs: Mapping[str, ContactPair], plan: Plan, robot: TaskRobot
) -> Controller:
    """Make the controller of the contacts that a plan names, also known to the robot.

    Contacts that push are open at first.

    Gains are `GAINS`, the metric of the motion filter is `METRIC`. Joint friction is identified,
    and compensated together with errors of the links' masses. The forces of contacts and wrists
    stop the arms above `LARGEST`; other settings have their default values.

    Args:
        model: modelled arms and object.
        pairs: contact pairs by name; those that the plan does not name are left out.
        plan: plan that names the contacts; their order is that of the columns of N.
        robot: robot at rest at the start, whose joint positions are the desired posture.
    """
    robot.controller = Controller(
        model,
        [pairs[name] for name in plan.contacts],
        GAINS,
        B=METRIC,
        posture=robot.q_start,
        life=PhaseSettings(),
        in_contact=False,
        joint_friction=JointFriction(errors=True),
        safety=SafetySettings(contact_ceiling=LARGEST, wrist_ceiling=LARGEST),
    )
    return robot.controller


def judged(task: Insertion, robot: InsertionRobot, plan: Plan) -> Inserted:
    """Result of a plan that has ended.

    Args:
        task: true peg and hole.
        robot: judge of the run.
        plan: plan that has ended.
    """
    X = robot.in_hole()
    across = task.clearance * float(np.linalg.norm(_way(task.peg).lowest))  # corners: the diagonal
    return result_of(
        robot, plan, float(X.translation[2]), X.rotation[:, 2], task.hole.depth, across
    )


def result_of(
    robot: TaskRobot, plan: Plan, depth: float, axis: Array, hole_depth: float, clearance: float
) -> Inserted:
    """Result of a plan that has ended, from the true place of the object.

    Args:
        robot: judge of the run.
        plan: plan that has ended.
        depth: depth of the tip in its hole (m).
        axis: (3,) axis of the peg in the frame of the hole.
        hole_depth: depth of the hole (m).
        clearance: width of the hole less that of the peg, where it is largest (m).
    """
    tilt = atan2(hypot(axis[0], axis[1]), axis[2])
    is_in = abs(hole_depth - depth) < SEATED and tilt <= clearance / (hole_depth - SEATED)
    is_resting = robot.speed() < STILL
    return Inserted(
        success=plan.outcome is Outcome.DONE and is_in and is_resting,
        reason=plan.reason,
        depth=depth,
        tilt=tilt,
        time=sum(verdict.duration for verdict in plan.verdicts),
        tries=sum(verdict.name == "find" for verdict in plan.verdicts),
        largest_sum=robot.largest_sum,
        largest_single=robot.largest_single,
        mean_sum=robot.mean_sum,
    )


@dataclass(frozen=True)
class _Way:
    """Contacts by which a peg of some shape enters its hole.

    Attributes:
        lowest: (3,) lowest point of the tilted tip, as multiples of half the widths.
        point: contact of this point with the face.
        edges: contacts of the tip's edges with the opposite rims, after the drop; none if round.
        sides: both contacts of the sides with the rims over which the point dropped, and the
            direction (3,) of each.
        upright: contacts with their forces (N) while the peg rotates.
        turned: contacts with their forces (N) of the rest of the rotation, after one of those was
            lost, and for a moment after the rotation; none if round.
        speed: speed on the way into the hole (m/s).
        yields: force (N) at which this motion stops.
        placed: whether the hole is placed where face and rims were touched, before it is entered.
    """

    lowest: Array
    point: str
    edges: tuple[str, ...]
    sides: dict[str, Array]
    upright: dict[str, float]
    turned: dict[str, float]
    speed: float
    yields: float
    placed: bool


_SQUARE = _Way(
    lowest=CORNERS["+x+y"],
    point="corner +x+y on face",
    edges=("edge +y on rim -x", "edge +x on rim -y"),
    sides={"side +x on rim +x": SIDES["+x"], "side +y on rim +y": SIDES["+y"]},
    upright={
        "side +x on rim +x, a": 2.0,
        "side +x on rim +x, b": 2.0,
        "side +y on rim +y": 4.0,
    },
    turned={"side +x on rim +x": 4.0, "side +y on rim +y": 4.0},
    speed=14e-3,
    yields=12.5,
    placed=False,
)
_BESIDE = {
    "a": (SIDES["+x"] + SIDES["+y"]) / sqrt(2.0),
    "b": (SIDES["+x"] - SIDES["+y"]) / sqrt(2.0),
}
_ROUND = _Way(
    lowest=SIDES["+x"],
    point="point +x on face",
    edges=(),
    sides={f"side +x on rim +x, {end}": side for end, side in _BESIDE.items()},
    upright={f"side +x on rim +x, {end}": 3.0 for end in _BESIDE},
    turned={},
    speed=12e-3,
    yields=10.0,
    placed=True,
)


@dataclass(frozen=True)
class PegSettings:
    """Search and forces of a plan.

    Attributes:
        tilt: tilt in each plane beyond that at which the hole is as wide as the peg (rad).
        push: force on the face during the search (N).
        drop: distance by which the lowest point drops when the hole is found (m).
        recent: time constant of the level from which a drop counts (s); inf: the level at the
            beginning of the slide. An object that creeps in its grasp drops slowly without a hole.
        asides: (k,) distances of the lines, along which the lowest point slides, from the middle of
            the believed hole (m), in their order, to and fro.
        length: length of the lines (m); inf: the only line does not end.
        sides: forces on the sides, as a share of those of the default settings.
        tip: force on the tip in the corner of the mouth, as such a share. Its friction must not
            hold what the forces on the sides move.
        paired: whether two points of a side of a rectangular peg keep it from turning about its
            axis while it becomes upright. They are too close to each other on narrow pegs.
        short: distance from the bottom within which a peg that rests is seated (m); negative: the
            object creeps in its grasp, so that the tip seems to be below the bottom.
        patience: time after which a side that was pressed in the corner, and is not any more, has
            been lost, so that the search begins again (s); inf: the controller alone judges, and
            stops.
    """

    tilt: float = radians(2.0)
    push: float = 6.0
    drop: float = 0.7e-3
    recent: float = inf
    asides: tuple[float, ...] = (0.0,)
    length: float = inf
    sides: float = 1.0
    tip: float = 1.0
    paired: bool = True
    short: float = 4e-3
    patience: float = inf


DEFAULTS = PegSettings()


def _way(peg: Peg) -> _Way:
    """Contacts by which a peg enters its hole."""
    return _SQUARE if peg.shape == "square" else _ROUND


def lowest_point(peg: Peg) -> Array:
    """Lowest point (3,) of the tilted tip, in the peg's frame (m)."""
    return peg.half * _way(peg).lowest


def tilt_of(peg: Peg, hole: Hole, settings: PegSettings = DEFAULTS) -> float:
    """Tilt (rad) of the peg at the start, too large for it to fall into the hole.

    In each plane it is by the `tilt` of the settings more than acos(w/W), at which the hole of the
    width W, seen along the axis of the peg, is as wide as the peg of the width w. About a diagonal
    the tilts in two planes add up to √2 times that in one.

    Args:
        peg: peg with its width.
        hole: hole with its width.
        settings: search and forces.
    """
    planes = float(np.linalg.norm(_way(peg).lowest))  # √2 about a diagonal
    share = float(np.min(peg.half[:2] / hole.half[:2]))
    return planes * (acos(share) + settings.tilt)


def peg_start(peg: Peg, hole: Hole, settings: PegSettings = DEFAULTS) -> pin.SE3:
    """Pose of a peg above the face, tilted so that the lowest point of its tip is beside the hole.

    Args:
        peg: peg, whose frame is that of the object.
        hole: hole at its believed pose.
        settings: search and forces.
    """
    lowest = _way(peg).lowest
    axis = np.cross(lowest, [0.0, 0.0, 1.0]) / np.linalg.norm(lowest)
    rotation = pin.exp3(tilt_of(peg, hole, settings) * axis)
    beside = settings.asides[0] * np.cross([0.0, 0.0, 1.0], lowest / np.linalg.norm(lowest))
    place = (hole.half + LEAD) * lowest + beside - HEIGHT * np.array([0.0, 0.0, 1.0])
    return hole.pose * pin.SE3(rotation, place - rotation @ lowest_point(peg))


def peg_plan(peg: Peg, hole: Hole, settings: PegSettings = DEFAULTS) -> Plan:
    """Plan of a square or round peg, from `peg_start`.

    Args:
        peg: peg, whose frame is that of the object.
        hole: hole at its believed pose.
        settings: search and forces.
    """
    stages = [
        *_search_stages(peg, hole, settings),
        *_entry_stages(peg, hole, settings),
        *_last_stages(peg, hole, settings),
    ]
    return Plan(stages, largest=60.0, tries=3)


def sunk(distance: float, direction: Array, point: Array, recent: float = inf) -> End:
    """Condition that a point of the object is farther along a direction than lately.

    Args:
        distance: least distance (m).
        direction: (3,) unit vector, world axes.
        point: (3,) point in the object's frame (m).
        recent: time constant of the level from which the distance counts (s); inf: the level at
            the beginning of the stage.
    """

    def begin(now: Sensed) -> Watch:
        """Begin with the present level."""
        level = float(direction @ now.X.act(point))

        def met(now: Sensed, dt: float) -> bool:
            """Update the low-passed level, and compare the present one with it.

            Args:
                now: signals after the last tick.
                dt: control period (s).
            """
            nonlocal level
            place = float(direction @ now.X.act(point))
            level += dt / recent * (place - level)
            return place - level >= distance

        return met

    return End(begin, f"sunk by {1e3 * distance:g} mm")


def _lines(settings: PegSettings, inward: Array, into: Array) -> Motion:
    """Motion along the lines of a search.

    Args:
        settings: lines of the search.
        inward: (3,) unit vector along the lines, towards the believed hole, world axes.
        into: (3,) unit vector into the believed hole, world axes.
    """
    if settings.length == inf:
        return along(inward, SLIDING)
    aside = np.cross(inward, into)
    ends = []
    for k, offset in enumerate(settings.asides):
        for far in (k % 2, 1 - k % 2):
            ends.append(far * settings.length * inward + (offset - settings.asides[0]) * aside)
    return through(np.array(ends[1:]), SLIDING, relative=True)


def _search_stages(peg: Peg, hole: Hole, settings: PegSettings) -> list[Stage]:
    """Stages until the lowest point of the tip has dropped into the hole.

    The tip is pressed on the face and slides along the lines of the search; the search ends when
    its lowest point has moved into the hole. The drop ends when that point touches again.

    Args:
        peg: peg with its width.
        hole: hole at its believed pose.
        settings: search and forces.
    """
    way = _way(peg)
    into = hole.pose.rotation[:, 2]  # down the hole, world axes
    # from the lowest point towards the middle of the hole
    inward = -hole.pose.rotation @ way.lowest / np.linalg.norm(way.lowest)
    push = {way.point: settings.push}
    dropped = sunk(settings.drop, into, lowest_point(peg), settings.recent)
    landed = made(way.point, lasting=0.15) & after(0.3)
    return [
        Stage("weigh", until=after(0.4), within=1.0, tare=True),
        Stage("find", push, until=made(way.point, lasting=0.15), within=4.0, fails="back"),
        Stage(
            "slide",
            push,
            _lines(settings, inward, into),
            until=dropped,
            within=4.0 if settings.length == inf else 25.0,
            unless=finished() if settings.length < inf else None,
            fails="back",
        ),
        Stage("drop", push, until=landed, within=2.0, fails="back"),
    ]


def _found(now: Sensed, peg: Peg, hole: Hole, *, aside: bool) -> pin.SE3:
    """Pose of the hole's body, from the poses in which the peg touched the face and the rims.

    The hole keeps its believed axes. Along them the shift δ (3,; m) of its mouth makes the gap of
    the face zero at the pose of the stage "find". If both sides touch, it also makes their gaps
    zero: n_iᵀδ = n_iᵀ(p_i − r_i), with the normals n_i of the sides, a point p_i of each side and a
    point r_i of its believed rim.

    Args:
        now: signals after the stage "find".
        peg: peg.
        hole: hole at its believed pose.
        aside: whether both sides touch their rims now; if not, the hole is only found along its
            axis.
    """
    way = _way(peg)
    pose = hole.pose
    into = pose.rotation[:, 2]
    touched = now.passed["find"].act(lowest_point(peg))
    shift = (into @ (touched - pose.translation)) * into
    if aside:
        normals, gaps = [into], [0.0]
        for side in way.sides.values():
            normal = now.X.rotation @ side
            apart = now.X.act(peg.half * side) - pose.act(hole.half * side) - shift
            normals.append(normal)
            gaps.append(float(normal @ apart))
        shift = shift + np.linalg.solve(np.array(normals), np.array(gaps))
    return hole.found_at(pin.SE3(pose.rotation, pose.translation + shift))


def _depth(now: Sensed, peg: Peg, into: Array) -> float:
    """Depth of the tip's origin below the point that touched the face (m).

    Args:
        now: signals after the stage "find".
        peg: peg.
        into: (3,) direction into the believed hole.
    """
    touched = now.passed["find"].act(lowest_point(peg))
    return float(into @ (now.X.translation - touched))


def _entry_stages(peg: Peg, hole: Hole, settings: PegSettings) -> list[Stage]:
    """Stages from a dropped tip to the bottom of the hole.

    Args:
        peg: peg with its width.
        hole: hole at its believed pose.
    """
    way = _way(peg)
    into = hole.pose.rotation[:, 2]

    def face_found(now: Sensed) -> pin.SE3:
        """Hole as high as the face that was touched."""
        return _found(now, peg, hole, aside=False)

    edges = []
    if way.edges:
        push = dict.fromkeys(way.edges, 3.5 * settings.sides)
        edges = [Stage("two points", push, until=after(0.4), within=2.0, fails="back")]
    corner_forces = dict.fromkeys(way.sides, 4.0 * settings.sides)
    corner_forces["tip on face"] = 4.0 * settings.tip
    is_pressed = made(*way.sides, lasting=0.3) | resting()
    is_at_bottom = deeper_than(peg, hole, hole.depth - settings.short, "at the bottom")
    return [
        *edges,
        Stage(
            "corner",
            corner_forces,
            until=is_pressed,
            within=4.0,
            unless=(lost("tip on face", lasting=0.8) & after(1.5))
            | lost_again(*way.sides, lasting=settings.patience),
            fails="back",
            places=dict.fromkeys(corner_forces, face_found) if way.placed else {},
        ),
        *_turn_stages(peg, hole, settings),
        Stage(
            "insert",
            {"hole": 0.0},
            along([0, 0, 1], way.speed, axes="object", yields=way.yields),
            until=(is_at_bottom & pressed(6.0, into) & at_rest(*RESTING)).lasting(0.3),
            within=10.0,
            fails="back",
            places={"hole": lambda now: hole.found_at(now.X)},
            then="done",
        ),
    ]


def resting() -> End:
    """Condition that the object rests, some time after the beginning of a stage."""
    return at_rest(*RESTING).lasting(0.3) & after(0.8)


def lost_again(*contacts: str, lasting: float) -> End:
    """Condition that one of these contacts has been closed, and is not any more for some time.

    Args:
        contacts: names of the contacts.
        lasting: this time (s); inf: the condition is never met.
    """

    def begin(now: Sensed) -> Watch:
        """Begin without a loss: times since each contact was closed (s); NaN: it was not yet."""
        since = dict.fromkeys(contacts, nan)

        def met(now: Sensed, dt: float) -> bool:
            """Update the times by a period, and compare the longest with `lasting`.

            Args:
                now: signals after the last tick.
                dt: control period (s).
            """
            for name in contacts:
                since[name] = 0.0 if now.phases[name] == Phase.CLOSED else since[name] + dt
            return any(time >= lasting for time in since.values())

        return met

    return End(begin, f"{' or '.join(contacts)} lost again", contacts)


def carried_by_bottom(peg: Peg, into: Array) -> End:
    """Condition that the bottom alone carries the peg: its walls need not press.

    A force f on the tip has a couple of at most f times the distance of the tip's farthest point
    across the axis. A larger couple is that of walls, between which a leaning peg is wedged; joint
    friction withstands it for up to a second until the force law has reduced it.

    Args:
        peg: peg.
        into: (3,) direction into the believed hole.
    """
    farthest = float(np.linalg.norm(lowest_point(peg)))

    def is_carried(now: Sensed) -> bool:
        """Test whether the couple across the axis is no larger than the bottom can cause (N m)."""
        across = np.cross(into, now.wrench[3:])
        return float(np.linalg.norm(across)) <= farthest * float(into @ now.wrench[:3])

    return when(is_carried, "carried by the bottom")


def deeper_than(peg: Peg, hole: Hole, depth: float, words: str) -> End:
    """Condition that the tip is deeper than a depth below the point that touched the face.

    Args:
        peg: peg.
        hole: hole at its believed pose.
        depth: depth (m).
        words: words for verdicts.
    """
    into = hole.pose.rotation[:, 2]
    return when(lambda now: _depth(now, peg, into) > depth, words)


def has_turned(peg: Peg, hole: Hole) -> End:
    """Condition that the rotation in the mouth is over: the peg is upright, or deep enough.

    Args:
        peg: peg.
        hole: hole at its believed pose.
    """
    into = hole.pose.rotation[:, 2]

    def is_parallel(now: Sensed) -> bool:
        """Test whether the commanded axis of the peg is parallel to that of the believed hole."""
        return float(now.aim.rotation[:, 2] @ into) > cos(PARALLEL)

    is_upright = when(is_parallel, "upright") & deeper_than(peg, hole, 3e-3, "3 mm deep")
    return deeper_than(peg, hole, 12e-3, "12 mm deep") | is_upright.lasting(0.2)


def turning(peg: Peg, hole: Hole, settings: PegSettings = DEFAULTS) -> Motion:
    """Rotation until the axis of the peg is that of the believed hole, while the peg moves in.

    Args:
        peg: peg.
        hole: hole at its believed pose.
        settings: search and forces.
    """
    into = hole.pose.rotation[:, 2]
    turn = turn_to([0, 0, 1], into, 0.5 * tilt_of(peg, hole, settings))
    return turn & along(into, 5e-3, yields=6.0)


def _turn_stages(peg: Peg, hole: Hole, settings: PegSettings) -> list[Stage]:
    """Stages in which a peg that is pressed into a corner of the mouth rotates until it is upright.

    The peg is turned until its axis is parallel to that of the believed hole while it moves into
    the hole, and its sides stay pressed against the rims; it ends upright or deep enough. Of a
    square peg, a side that is lost does not end the rotation, which continues with fewer contacts.

    Args:
        peg: peg with its width.
        hole: hole at its believed pose.
    """
    way = _way(peg)

    def rims_found(now: Sensed) -> pin.SE3:
        """Hole as high as the face, where the sides touch its rims."""
        return _found(now, peg, hole, aside=True)

    motion = turning(peg, hole, settings)
    contacts = way.upright if settings.paired or not way.turned else way.turned
    pressing = {name: force * settings.sides for name, force in contacts.items()}
    pressing_on = {name: force * settings.sides for name, force in way.turned.items()}
    is_deep = deeper_than(peg, hole, 2.5e-3, "in the mouth")
    until = has_turned(peg, hole)
    continues = bool(way.turned) and contacts is not way.turned
    is_lost = lost(*contacts, lasting=0.7 if continues else 0.5)
    is_over = until | (is_lost if continues else is_lost & is_deep)
    upright = Stage(
        "upright",
        pressing,
        motion,
        until=is_over,
        within=8.0,
        unless=lost(*contacts, lasting=0.8),
        fails="back",
        places=dict.fromkeys(contacts, rims_found) if way.placed else {},
    )
    if not continues:
        return [upright]
    turn_on = Stage(
        "turn on",
        pressing_on,
        motion,
        until=until | (lost(*way.turned, lasting=0.5) & is_deep),
        within=4.0,
        unless=lost(*way.turned, lasting=0.9),
        fails="back",
    )
    return [upright, turn_on]


def _last_stages(peg: Peg, hole: Hole, settings: PegSettings) -> list[Stage]:
    """Stages after a failure, which lead back to the search, and the last stage of a success.

    Args:
        peg: peg with its width.
        hole: hole at its believed pose.
    """
    into = hole.pose.rotation[:, 2]
    start = peg_start(peg, hole, settings)
    stands = (at_rest(*RESTING) & carried_by_bottom(peg, into)).lasting(0.1)
    return [
        Stage("back", {}, along(-into, 20e-3, 30e-3), until=finished(), within=4.0, then="return"),
        Stage("return", {}, to(start, 30e-3, 0.5), until=finished(), within=8.0, then="find"),
        Stage("done", {"hole": 0.0}, until=stands | after(2.0), within=4.0),
    ]

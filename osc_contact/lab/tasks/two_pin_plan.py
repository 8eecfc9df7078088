"""Plan of two arms that insert both pins of a bar into holes that are not where they are modelled.

The bar is rolled about its long axis, so that the lowest point of each tip is at its side +y, and
yawed, so that the left pin is ahead. Both points are put down on the face, which shows its height
and its pitch, and slide until the left one drops into its mouth. Its side is pressed against the
rim, where the bar turns until the right point drops, too. Both sides are pressed against their
rims, which shows the yaw of the block; the bar rolls there until it is upright, and goes in. After
a failure it is drawn back, and the search begins again.
"""

from __future__ import annotations

from math import cos, radians

import numpy as np
import pinocchio as pin

from osc_contact.contacts.insertion import SIDES, pairs_between
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.contacts.pairs.tangent_pair import Prismatic
from osc_contact.control.controller import Controller
from osc_contact.lab.tasks.insertion import BELIEVED, DEPTH, TaskRobot
from osc_contact.lab.tasks.pegs import (
    PARALLEL,
    Inserted,
    controller_for,
    resting,
    result_of,
    tilt_of,
)
from osc_contact.lab.tasks.two_pins import HALF, NAMES, WIDTH, TwoPins
from osc_contact.loop.loop import run_loop
from osc_contact.plan.ends import (
    End,
    Watch,
    after,
    at_rest,
    finished,
    lost,
    made,
    moved,
    pressed,
    when,
)
from osc_contact.plan.motions import about, along, to, turn_to
from osc_contact.plan.plan import Plan
from osc_contact.plan.sensed import Sensed
from osc_contact.plan.stage import Stage
from osc_contact.spatial import Array

LEAD = 4.5e-3  #: distance from the left rim outward to the point where the left tip touches (m)
AHEAD = radians(1.7)  #: yaw of the bar at first, by which the left pin is ahead (rad)
HEIGHT = 8e-3  #: height of the left tip above the face at the start (m)
#: Lowest point (3,) of each tip of the rolled bar, in the frame of the bar (m).
POINTS = {
    name: 0.5 * WIDTH * SIDES["+y"] + offset * SIDES["+x"]
    for name, offset in zip(NAMES, (-HALF, HALF), strict=True)
}
LEFT_POINT, RIGHT_POINT = (f"{name} point +y on face" for name in NAMES)
LEFT_RIM, RIGHT_RIM = (f"{name} side +y on rim +y" for name in NAMES)
BOTH = "both pins in their holes"
INTO = BELIEVED.rotation[:, 2]  #: direction into the modelled holes
SIDEWAYS = BELIEVED.rotation[:, 1]  #: direction of the side +y of the modelled block


def insert_both(task: TwoPins) -> Inserted:
    """Insert both pins by `two_pin_plan`, from the pose of `bar_start`.

    Robot and scene are not checked before the run: the checks take the sides of a pin above its
    hole for endless faces, which would press into rims. The plan is checked in any case.

    Args:
        task: bar and block of a seed.
    """
    robot, plan, controller = prepared(task)
    run_loop(robot, controller, plan, check=False)
    return judged(task, robot, plan)


def prepared(task: TwoPins) -> tuple[TaskRobot, Plan, Controller]:
    """Robot at its start, plan, and controller of a task.

    Args:
        task: bar and block of a seed.
    """
    plan = two_pin_plan(task)
    robot = task.robot(bar_start(task))
    return robot, plan, controller_for(task.model, pairs_of(task), plan, robot)


def pairs_of(task: TwoPins) -> dict[str, ContactPair]:
    """Pairs of both pins with their holes by name, and of the bar that slides in both.

    Args:
        task: modelled pins and holes.
    """
    pairs: dict[str, ContactPair] = {}
    for name in NAMES:
        pairs |= pairs_between(task.pegs[name], task.holes[name], prefix=f"{name} ")
    pairs[BOTH] = Prismatic([0, 0, 0], [0, 0, 1], BELIEVED, name=BOTH)
    return pairs


def judged(task: TwoPins, robot: TaskRobot, plan: Plan) -> Inserted:
    """Result of a plan that has ended; the depth is that of the less deep pin.

    Args:
        task: true bar and block.
        robot: judge of the run.
        plan: plan that has ended.
    """
    X = task.true_block.actInv(robot.pose())  # the bar in the frame of the block
    depth = min(float(X.act(task.pegs[name].pose.translation)[2]) for name in NAMES)
    return result_of(robot, plan, depth, X.rotation[:, 2], DEPTH, task.clearance)


def roll_of(task: TwoPins) -> float:
    """Roll of the bar at first (rad).

    Args:
        task: modelled pins and holes.
    """
    return tilt_of(task.pegs["left"], task.holes["left"])


def bar_start(task: TwoPins) -> pin.SE3:
    """Pose of the bar above the face, rolled and yawed, with the left tip beside its hole.

    Args:
        task: modelled pins and holes.
    """
    yaw = pin.exp3(np.array([0.0, 0.0, AHEAD]))
    rotation = yaw @ pin.exp3(np.array([roll_of(task), 0.0, 0.0]))
    beside = np.array([-HALF, 0.5 * task.holes["left"].width + LEAD, -HEIGHT])
    return BELIEVED * pin.SE3(rotation, beside - rotation @ POINTS["left"])


def two_pin_plan(task: TwoPins) -> Plan:
    """Plan of both pins, from `bar_start`.

    Args:
        task: modelled pins and holes.
    """
    stages = [*_search_stages(), *_entry_stages(task), *_last_stages(task)]
    return Plan(stages, largest=60.0, tries=3)


def _search_stages() -> list[Stage]:
    """Stages until the lowest points of both tips have dropped into their holes."""
    push = {LEFT_POINT: 6.0, RIGHT_POINT: 6.0}
    turning = {LEFT_RIM: 5.0, RIGHT_POINT: 6.0}
    landed = made(LEFT_POINT, RIGHT_POINT, lasting=0.15)
    is_pressed = made(LEFT_RIM, lasting=0.2) | resting()
    inward, turn = along(-SIDEWAYS, 6e-3), about(-INTO, 0.025)
    left_dropped, right_dropped = _dropped("left", LEFT_POINT), _dropped("right", RIGHT_POINT)
    return [
        Stage("weigh", until=after(0.4), within=1.0, tare=True),
        Stage("find", push, until=landed, within=4.0, fails="back"),
        Stage("slide", push, inward, until=left_dropped, within=4.0, fails="back"),
        Stage("left rim", turning, until=is_pressed, within=4.0, fails="back"),
        Stage("turn", turning, turn, until=right_dropped, within=5.0, fails="back"),
    ]


def sunk(name: str) -> End:
    """Condition that the tip of a pin has moved into its hole.

    Args:
        name: name of the pin.
    """
    return moved(0.5e-3, INTO, point=POINTS[name])


def _stays(distance: float, seconds: float) -> End:
    """Condition that the bar has stayed in place; slow creep is below the noise of its speed.

    Args:
        distance: distance within which its origin stays (m).
        seconds: time for which it stays (s).
    """

    def begin(now: Sensed) -> Watch:
        """Begin at the present place of the bar (`place`), where it has been for no time.

        Args:
            now: signals when the stage begins.

        Returns:
            Function of the signals of a tick and the period: whether the bar has stayed.
        """
        place = now.X.translation.copy()
        stayed = 0.0

        def met(now: Sensed, dt: float) -> bool:
            """Add a period (s) to the time, or begin again where the bar has moved to.

            Args:
                now: signals after the last tick.
                dt: control period (s).
            """
            nonlocal place, stayed
            stayed += dt
            if np.linalg.norm(now.X.translation - place) > distance:
                place, stayed = now.X.translation.copy(), 0.0
            return stayed >= seconds

        return met

    return End(begin, f"within {1e3 * distance:g} mm for {seconds:g} s")


def _dropped(name: str, contact: str) -> End:
    """Condition that the tip of a pin has dropped, or has been off the face for a while.

    Args:
        name: name of the pin.
        contact: its contact with the face.
    """
    return sunk(name) | lost(contact, lasting=0.1)


def _touched(now: Sensed) -> dict[str, Array]:
    """Points (3,) of the face that both tips touched, by name, in the world (m).

    Args:
        now: signals after the stage "find".
    """
    return {name: now.passed["find"].act(point) for name, point in POINTS.items()}


def _depth(now: Sensed) -> float:
    """Depth of the middle between both tips below the points that touched the face (m).

    Args:
        now: signals after the stage "find".
    """
    touched = _touched(now)
    middle = 0.5 * (touched["left"] + touched["right"])
    return float(INTO @ (now.X.translation - middle))


def _found(now: Sensed, task: TwoPins) -> pin.SE3:
    """Pose of the block's middle while both sides touch their rims.

    Height and pitch are those of the face that both tips touched, yaw and y those of both sides;
    roll and x are as modelled.

    Args:
        now: signals in the stage "upright".
        task: modelled pins and holes.
    """
    touched = _touched(now)
    # x is the horizontal direction of the bar, with the pitch of the face; z is next to INTO
    line = touched["right"] - touched["left"]
    rise = float(INTO @ line) / float(np.linalg.norm(line))
    level = now.X.rotation[:, 0] - float(INTO @ now.X.rotation[:, 0]) * INTO
    x = level * (np.sqrt(1.0 - rise**2) / np.linalg.norm(level)) + rise * INTO
    z = INTO - (INTO @ x) * x
    z /= np.linalg.norm(z)
    y = np.cross(z, x)

    # the middle of the left hole is half its width behind the side, at the height of the face
    side = now.X.rotation[:, 1]
    on_side = now.X.act(np.array([-HALF, 0.5 * WIDTH, 0.0]))
    modelled = task.holes["left"]
    coordinates = np.array(
        [
            x @ modelled.pose.translation,
            side @ on_side - 0.5 * modelled.width * (side @ y),
            z @ touched["left"],
        ]
    )
    middle = np.linalg.solve(np.array([x, side, z]), coordinates)
    return pin.SE3(np.column_stack((x, y, z)), middle + HALF * x)


def _into_found(now: Sensed, task: TwoPins) -> Array:
    """Direction (3,) into the holes that were found.

    Args:
        now: signals in the stage "upright".
        task: modelled pins and holes.
    """
    return _found(now, task).rotation[:, 2]


def _deeper_than(depth: float, words: str) -> End:
    """Condition that the tips are deeper than a depth.

    Args:
        depth: depth below the points that touched the face (m).
        words: words for verdicts.
    """
    return when(lambda now: _depth(now) > depth, words)


def has_turned(task: TwoPins) -> End:
    """Condition that the roll in the mouths is over: the bar is upright, or deep enough.

    Args:
        task: modelled pins and holes.
    """

    def is_parallel(now: Sensed) -> bool:
        """Test whether the commanded axis of the pins is parallel to that of the holes found."""
        return float(now.aim.rotation[:, 2] @ _into_found(now, task)) > cos(PARALLEL)

    is_upright = when(is_parallel, "upright") & _deeper_than(3e-3, "3 mm deep")
    return _deeper_than(12e-3, "12 mm deep") | is_upright.lasting(0.2)


def _entry_stages(task: TwoPins) -> list[Stage]:
    """Stages from dropped tips to the bottom of both holes.

    Args:
        task: modelled pins and holes.
    """
    to_block = BELIEVED.inverse()

    def block_found(now: Sensed) -> pin.SE3:
        """Pose of the frame in which the pairs were made, from that of the block found."""
        return _found(now, task) * to_block

    sides = {LEFT_RIM: 5.0, RIGHT_RIM: 5.0}
    down = along(INTO, 5e-3, yields=8.0)
    roll = turn_to([0, 0, 1], lambda now: _into_found(now, task), 0.5 * roll_of(task))
    is_pressed = made(*sides, lasting=0.3) | resting()
    has_entered = lost(*sides, lasting=0.5) & _deeper_than(2.5e-3, "in the mouths")
    at_bottom = _deeper_than(DEPTH - 4e-3, "at the bottom") & pressed(6.0, INTO)
    return [
        Stage("corner", sides, down, until=is_pressed, within=4.0, fails="back"),
        Stage(
            "upright",
            sides,
            roll & down,
            until=has_turned(task) | has_entered,
            within=8.0,
            unless=lost(*sides, lasting=0.8),
            fails="back",
            places=dict.fromkeys(sides, block_found),
        ),
        Stage(
            "insert",
            {BOTH: 0.0},
            along([0, 0, 1], 12e-3, axes="object", yields=12.0),
            until=(at_bottom & at_rest(2e-3, 0.02)).lasting(0.3),
            within=10.0,
            fails="back",
            places={BOTH: lambda now: now.X * to_block},
            then="done",
        ),
    ]


def _last_stages(task: TwoPins) -> list[Stage]:
    """Stages after a failure, which lead back to the search, and the last stage of a success.

    Args:
        task: modelled pins and holes.
    """
    start = bar_start(task)
    return [
        Stage("back", {}, along(-INTO, 30e-3, 40e-3), until=finished(), within=4.0, then="return"),
        Stage("return", {}, to(start, 30e-3, 0.5), until=finished(), within=8.0, then="find"),
        Stage("done", {BOTH: 0.0}, until=_stays(1e-4, 0.2) | after(2.0), within=4.0),
    ]

"""Checks of robot, controller and references, which `run_loop` makes before the first command."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from itertools import chain as joined
from itertools import islice

from osc_contact.control.controller import Controller
from osc_contact.errors import InvalidInputError, brief
from osc_contact.interface import Reference
from osc_contact.loop.arm_rules import (
    first_tick,
    joints,
    motors,
    postures,
    rate,
    stretched,
    weights,
)
from osc_contact.loop.protocols import Measures
from osc_contact.loop.reference_rules import (
    contradiction,
    far_off,
    force_ceilings,
    jump,
    lag,
    lifted,
    measured_range,
    pulls,
    spacing,
    speed_ceiling,
    together,
    uncontrolled,
)
from osc_contact.loop.robot_task import task_of_robot
from osc_contact.loop.rules import Finding, Task, findings
from osc_contact.loop.scene_rules import SCENE_RULES

REHEARSED = 2000  #: largest number of ticks of a motion that `run_loop` simulates beforehand
_logger = logging.getLogger("osc_contact.preflight")


def checked(
    robot: Measures, controller: object, references: Iterable[Reference]
) -> Iterable[Reference]:
    """Check robot, controller and references of a loop by all rules; return the references.

    A sequence is checked as a whole. Of an iterator only the first reference is checked, which is
    logged; the result begins with this reference. Warnings are logged.

    Args:
        robot: robot at rest at the start of the loop; it is measured, but not commanded.
        controller: a `Controller`, which is not changed; with another object nothing is checked.
        references: references of the loop, one for each tick.

    Raises:
        InvalidInputError: a rule refuses the task; the message has all findings.
    """
    if not isinstance(controller, Controller):
        return references
    sequence = references
    if not isinstance(sequence, Sequence):
        try:
            iterator = iter(sequence)
        except TypeError as error:
            raise InvalidInputError(
                f"references is {brief(sequence)}; give one for each tick, such as a list of "
                "osc.Reference, or itertools.repeat(reference, ticks)"
            ) from error
        # the first reference is taken from the iterator, checked, and put back before the others
        sequence = list(islice(iterator, 1))
        references = joined(sequence, iterator)
        _logger.info(
            "the references are an iterator: only the first of them is checked before the start; "
            "a list is checked as a whole"
        )
    all_findings = judge_robot(task_of_robot(robot, controller, sequence, REHEARSED))
    refusals = [finding.text for finding in all_findings if finding.refused]
    if refusals:
        raise InvalidInputError(
            "\n".join(refusals) + "\n(these are compared before the first command; "
            "check=False leaves it out)"
        )
    for finding in all_findings:
        _logger.warning("doubtful: %s", finding.text)
    return references


def judge_robot(task: Task) -> tuple[Finding, ...]:
    """Findings on a robot with its controller and references, by all rules.

    If the state at rest or the scene is refused, the motion is not judged: further findings would
    be consequences.

    Args:
        task: task of the robot, for example by `task_of_robot`; its `scene` is judged if it is
            known.
    """
    at_rest = findings(ROBOT_RULES, task)
    if task.scene is not None:
        at_rest += findings(SCENE_RULES, task)
    if any(finding.refused for finding in at_rest):
        return tuple(at_rest)
    return (*at_rest, *judge_motion(task))


def judge_motion(task: Task) -> tuple[Finding, ...]:
    """Findings on the motions and forces of a task: gains, ceilings, reach, joints, motors.

    The motion of the joints is simulated only if `MOTION_RULES` find nothing.

    Args:
        task: chain, contacts, references and settings of a run.
    """
    motion = findings(MOTION_RULES, task) or findings((joints,), task)
    return (*findings((rate, *CEILINGS), task), *motion, *findings((motors,), task))


#: All rules on a task; a new rule is added to one of these lists. `joints` simulates a motion only
#: if `MOTION_RULES` have no findings.
ROBOT_RULES = (first_tick, jump, weights, pulls, measured_range, spacing, contradiction)
CEILINGS = (force_ceilings, speed_ceiling)
MOTION_RULES = (stretched, postures, lifted, together, far_off, uncontrolled, lag)

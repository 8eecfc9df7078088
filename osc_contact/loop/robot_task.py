"""Task of a robot at rest with its controller and references, to be judged by rules."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.feet import contact_at, force_owners
from osc_contact.control.controller import Controller
from osc_contact.control.status import Status
from osc_contact.errors import InvalidInputError, brief
from osc_contact.interface import Measurement, Reference
from osc_contact.loop.protocols import Measures
from osc_contact.loop.rules import Task
from osc_contact.recorder.recording import column_names
from osc_contact.spatial import Array

LOOKS = 400  #: number of evenly spaced references that are checked, in addition to extreme ones
READINGS = 10  #: number of measurements to wait for one that can be computed (late sensors)
MOST_COMPARED = 50_000  #: largest number of references whose poses and forces are searched


def task_of_robot(
    robot: Any,
    controller: Controller,
    references: Sequence[Reference],
    rehearsed: int | None = None,
) -> Task:
    """Make the task of a robot at rest at the start of its loop; the robot is measured.

    Args:
        robot: a `Robot`, optionally with a method `scene`.
        controller: its controller.
        references: desired motions and forces, one for each tick, from the first on.
        rehearsed: largest number of ticks for which the motion of the joints may be simulated;
            None: the whole motion.

    Raises:
        InvalidInputError: there are no references, one of them has not one force for each column,
            or the robot has other joints than the controller's model.
    """
    settings = controller.settings
    pairs = settings.contacts
    chain = settings.chain
    dt = settings.dt
    assert settings.posture is not None  # settings choose the neutral one
    owners = force_owners(pairs)
    _require_forces(references, len(owners))
    measured = _first_measurement(robot, controller, references[0])
    q = np.asarray(measured.q, dtype=float)
    if chain.nq != len(q):
        raise InvalidInputError(f"the robot measures {len(q)} joints of {chain.nq}")
    state = chain.state(q)
    looks = _checked_indices(references)
    active = _active_contacts([references[k] for k in looks], len(pairs))
    forces = np.array([references[k].alpha_d for k in looks])
    following = looks[looks < len(references) - 1]
    names = column_names([pair.name for pair in pairs], owners.tolist())
    return Task(
        chain=chain,
        pairs=pairs,
        gains=settings.gains,
        dt=dt,
        posture=settings.posture,
        safety=settings.safety,
        q=q,
        q_contact=q,
        state=state,
        contact=contact_at(pairs, state.X_WO),
        times=looks * dt,
        poses=np.array([pin.SE3ToXYZQUAT(references[k].X_WD) for k in looks]),
        forces=forces if active is None else forces * active[:, owners],
        active=active,
        trial=partial(_engaged_copy, controller, measured),
        rates=_rows_of_six(
            [_displacement(references[k], references[k + 1]) / dt for k in following]
        ),
        twists=_rows_of_six([0.5 * (references[k].V_D + references[k + 1].V_D) for k in following]),
        squeezes=np.array([np.abs(references[k].squeeze_d).sum() for k in looks]),
        commanded=np.array([references[k].V_D for k in looks]),
        every=lambda period: iter(references[:: max(1, round(period / dt))]),
        force_names=[f"alpha_d of {name}" for name in names],
        owners=owners,
        rests=[body is None for body in settings.bodies],
        bound=settings.life is None,
        rehearsed=rehearsed,
        controller=controller,
        measured=measured,
        scene=robot.scene() if hasattr(robot, "scene") else None,
    )


def _active_contacts(references: Sequence[Reference], contacts: int) -> Array | None:
    """Active contacts (k, contacts) of k references, 1 or 0; None if no reference names any.

    Args:
        references: checked references of a loop.
        contacts: number of contacts.
    """
    if all(reference.active is None for reference in references):
        return None
    all_active = np.ones(contacts)
    rows = [
        all_active if reference.active is None else reference.active != 0
        for reference in references
    ]
    return np.array(rows, float)


def _engaged_copy(controller: Controller, measured: Measurement) -> tuple[Controller, Measurement]:
    """Copy of a controller with its contacts engaged, and the measurement.

    Args:
        controller: controller of the loop, which is not changed.
        measured: measurement at rest.
    """
    trial = copy(controller)
    trial.engaged = True
    return trial, measured


def _rows_of_six(twists: Sequence[Array]) -> Array:
    """Stack k twists (6,) as the rows of an array (k, 6); of no twists make (0, 6)."""
    return np.array(twists, dtype=float).reshape(-1, 6)


def _require_forces(references: Sequence[Reference], r: int) -> None:
    """Refuse references of another class, or without r desired forces.

    Args:
        references: references of a loop, one for each tick.
        r: number of columns of N of all contacts.

    Raises:
        InvalidInputError: there are no references, or one of them is of another kind.
    """
    if not len(references):
        raise InvalidInputError(
            "there are no references; give one for each tick (a generator gives its own only once)"
        )
    for k, reference in enumerate(references):
        if not isinstance(reference, Reference):
            raise InvalidInputError(
                f"reference {k} is {brief(reference)}; give osc.Reference(X_WD, V_D, A_D, alpha_d)"
            )
        if len(reference.alpha_d) != r:
            raise InvalidInputError(
                f"reference {k}: alpha_d has shape {reference.alpha_d.shape}, and the contacts "
                f"have {r} columns of N; give one force for each (N)"
            )


def _first_measurement(robot: Measures, controller: Controller, first: Reference) -> Measurement:
    """Measure the robot until a tick can be computed, up to `READINGS` times.

    Sensors that start late do not deliver a reading at once; each measurement is tried by a copy of
    the controller.

    Args:
        robot: robot at rest.
        controller: controller of the loop, which is not changed.
        first: reference of the first tick.

    Returns:
        Last measurement; a tick with it is computed, or `READINGS` measurements failed.
    """
    for _ in range(READINGS):
        measurement = robot.measure()
        trial = copy(controller)
        trial.tick(measurement, first)
        if trial.status is not Status.HELD:
            break
    return measurement


def _checked_indices(references: Sequence[Reference]) -> Array:
    """Indices (k,) of the checked references: evenly spaced, extreme, with new active contacts.

    Extreme are the references with the smallest and largest coordinates of the position and
    desired forces. Of a long sequence only every `step`-th reference is searched.

    Args:
        references: references of a loop, one for each tick.
    """
    step = -(-len(references) // MOST_COMPARED)  # quotient, rounded up
    searched = references[::step]
    positions = np.array([reference.X_WD.translation for reference in searched])
    forces = np.array([reference.alpha_d for reference in searched])
    numbers = np.hstack((positions, forces.reshape(len(positions), -1)))
    extreme = step * np.append(numbers.argmin(axis=0), numbers.argmax(axis=0))
    even = np.linspace(0, len(references) - 1, LOOKS).astype(int)
    sets = [
        None if reference.active is None else reference.active.tobytes() for reference in searched
    ]
    new = [step * k for k in range(1, len(sets)) if sets[k] != sets[k - 1]]
    return np.unique(np.concatenate((even, extreme, np.array(new, dtype=int))))


def _displacement(before: Reference, after: Reference) -> Array:
    """Displacement (6,) of X_WD from one reference to the next (m, rad), world axes.

    Args:
        before: first reference.
        after: second reference.
    """
    X = before.X_WD
    rotation = pin.log3(after.X_WD.rotation @ X.rotation.T)
    return np.concatenate((after.X_WD.translation - X.translation, rotation))

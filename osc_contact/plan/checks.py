"""Checks of a plan before it runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.contacts.feet import force_owners
from osc_contact.contacts.pairs.pair import AT_REST
from osc_contact.control.status import Phase
from osc_contact.errors import InvalidInputError, OscContactError, did_you_mean
from osc_contact.plan.ends import End
from osc_contact.plan.permitted import Demand, permitted_twist
from osc_contact.plan.sensed import Sensed, forces_of
from osc_contact.plan.stage import Stage
from osc_contact.recognition.recogniser import Recogniser
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from osc_contact.control.controller import Controller

BLOCKED = 0.99  #: share of a motion that contacts take away above which it is refused


def require_stages(stages: Sequence[Stage]) -> None:
    """Refuse stages that do not make a plan by themselves.

    Raises:
        InvalidInputError: no stages, equal names, or a stage that follows and does not exist.
    """
    names = [stage.name for stage in stages]
    if not names:
        raise InvalidInputError("the plan has no stages; give one at least, such as osc.Stage(…)")
    if repeated_names := sorted({name for name in names if names.count(name) > 1}):
        raise InvalidInputError(
            f"several stages are named {repeated_names[0]!r}; give each its own name"
        )
    for stage in stages:
        for key in ("then", "fails"):
            name = getattr(stage, key)
            if name is not None and name not in names:
                raise InvalidInputError(
                    f"stage {stage.name!r}: {key}={name!r} does not exist; "
                    f"{did_you_mean(name, names)}"
                )


def require_plan(
    stages: Sequence[Stage], largest: float, controller: Controller, X: pin.SE3
) -> None:
    """Refuse stages that a controller cannot carry out; contacts are judged in the start pose.

    Args:
        stages: stages of the plan.
        largest: measured force that ends a stage (N).
        controller: controller of the run.
        X: pose of the object at the start.

    Raises:
        InvalidInputError: contacts that do not exist or contradict one another, conditions on
            contacts that are not active, forces above their limits, a motion that the contacts of
            its stage do not permit at all.
    """
    settings = controller.settings
    names = [pair.name for pair in settings.contacts]
    owners = force_owners(settings.contacts)
    for stage in stages:
        try:
            alpha_d, active = forces_of(stage.forces, names, owners)
            _require_contacts(stage, names)
            N = _force_directions(controller, active, X)
        except OscContactError as error:
            raise InvalidInputError(f"stage {stage.name!r}: {error}") from error
        _require_forces(stage, alpha_d, min(stage.largest, largest), controller)
        _require_motion(stage, names, N, controller.dt, X)


def require_states(stages: Sequence[Stage], recogniser: Recogniser | None) -> None:
    """Refuse conditions on contact states that the plan's recogniser does not have.

    Args:
        stages: stages of the plan.
        recogniser: recogniser of the plan; None: it has none.

    Raises:
        InvalidInputError: such a state, a plan without recogniser, or an unknown pair.
    """
    for stage in stages:
        ends = [
            condition for condition in (stage.until, stage.unless) if isinstance(condition, End)
        ]
        needed = [condition for condition in ends if condition.states is not None]
        if (needed or stage.may_touch) and recogniser is None:
            raise InvalidInputError(
                f"stage {stage.name!r} depends on the contact state; give the plan a recogniser, "
                "osc.Plan(…, recogniser=osc.Recogniser(…))"
            )
        if recogniser is None:
            continue
        for name in (name for condition in needed for name in condition.states or ()):
            if name not in recogniser.states.names:
                raise InvalidInputError(
                    f"stage {stage.name!r}: there is no contact state {name!r}; "
                    f"{did_you_mean(name, recogniser.states.names)}"
                )
        for name in stage.may_touch:
            if name not in recogniser.states.pairs:
                raise InvalidInputError(
                    f"stage {stage.name!r}: may_touch={name!r} is in no contact state; "
                    f"{did_you_mean(name, recogniser.states.pairs)}"
                )


def _require_contacts(stage: Stage, names: Sequence[str]) -> None:
    """Refuse conditions on contacts that are not active in the stage, and unknown contacts.

    Args:
        stage: stage of a plan.
        names: names of all contacts of the controller.

    Raises:
        InvalidInputError: such a contact, with its name.
    """
    contacts: list[str] = []
    for condition in (stage.until, stage.unless):
        if isinstance(condition, End):
            contacts += condition.contacts
    for name in (*contacts, *stage.places):
        if name not in names:
            raise InvalidInputError(f"there is no contact {name!r}; {did_you_mean(name, names)}")
    for name in contacts:
        if name not in stage.forces:
            raise InvalidInputError(
                f"it ends by contact {name!r}, which is not active in it; add it to its forces, "
                "with 0.0 where it is to be approached only"
            )


def _force_directions(controller: Controller, active: Array, X: pin.SE3) -> Array:
    """Independent directions of force (6, r) of the active contacts, at O in world axes.

    Args:
        controller: controller with the contacts.
        active: (contacts,) 1 for active contacts, else 0.
        X: pose of the object.
    """
    pairs = controller.settings.contacts
    contacts = [pairs[k].contact(X, AT_REST) for k in np.flatnonzero(active).tolist()]
    return Contact.stack(contacts).N if contacts else np.zeros((6, 0))


def _require_forces(stage: Stage, alpha_d: Array, limit: float, controller: Controller) -> None:
    """Refuse forces above the largest one, or above the ceiling of a contact.

    Args:
        stage: stage of a plan.
        alpha_d: (r,) desired forces of the stage (N).
        limit: measured force above which the stage would fail (N).
        controller: controller with the ceiling `control.safety.contact_ceiling`.

    Raises:
        InvalidInputError: a force or the sum of all forces is too large.
    """
    total = float(np.abs(alpha_d).sum())
    if total > limit:
        raise InvalidInputError(
            f"stage {stage.name!r} commands {total:g} N in all, and fails above {limit:g} N; lower "
            "its forces, or raise largest="
        )
    ceiling = controller.settings.safety.contact_ceiling
    highest = float(np.abs(alpha_d).max(initial=0.0))
    if ceiling is not None and highest > ceiling:
        raise InvalidInputError(
            f"stage {stage.name!r} commands {highest:g} N, above safety.contact_ceiling = "
            f"{ceiling:g} N, at which the arms are stopped; lower the force, or raise the ceiling"
        )


def _require_motion(stage: Stage, names: Sequence[str], N: Array, dt: float, X: pin.SE3) -> None:
    """Refuse a motion whose velocity or rotation the contacts of its stage block altogether.

    Args:
        stage: stage of a plan.
        names: names of all contacts of the controller.
        N: (6, r) independent directions of force of the stage's contacts.
        dt: control period (s).
        X: pose of the object at the start.

    Raises:
        InvalidInputError: contacts take away more than the share `BLOCKED` of the motion.
    """
    signals = Sensed(
        X=X,
        V=np.zeros(6),
        aim=X,
        wrench=np.zeros(6),
        forces=dict.fromkeys(names, 0.0),
        phases=dict.fromkeys(names, Phase.OPEN),
        start=X,
        N=N,
    )
    try:
        demand = stage.motion.begin(signals)(signals, dt)
    except (InvalidInputError, LookupError):
        return  # its direction follows from stages before it, and is checked when the stage begins
    for kind, rows in (("velocity", slice(0, 3)), ("turn", slice(3, 6))):
        used_rows = np.flatnonzero(np.any(demand.rows[:, rows] != 0.0, axis=1))
        values = demand.values[used_rows]
        size = float(np.linalg.norm(values))
        if size == 0.0:
            continue
        _, misfit = permitted_twist(N, Demand(demand.rows[used_rows], values))
        if float(np.linalg.norm(misfit)) > BLOCKED * size:
            contacts = " and ".join(stage.forces)
            raise InvalidInputError(
                f"stage {stage.name!r}: {contacts} permit no {kind} of {stage.motion.words}; "
                "release a contact, or command another motion"
            )

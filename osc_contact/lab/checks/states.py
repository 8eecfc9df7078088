"""Contact states of a scenario that its sensors cannot distinguish, for `inspect`."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, combinations
from typing import Any

import numpy as np

from osc_contact.contacts.pairs.pair import count_forces, pushes_only
from osc_contact.lab.rig.rig import Rig
from osc_contact.recognition.states import MOST_COLUMNS, ContactStates, WrenchErrors

MOST_CONTACTS = 4  #: largest number of contacts whose states are compared, 16 states
FREE = "none"  #: name of the state without contacts


def undistinguished(rig: Rig) -> Iterator[str]:
    """Sentence for each group of contact states that wrenches cannot distinguish at the start.

    States are all sets of contacts that push. Only rigs with one arm are judged, because with
    several ones the wrench of the object is read by several sensors with different levers.

    Args:
        rig: rig of a scenario.
    """
    names = [pair.name for pair in rig.pairs if pushes_only(pair)]
    columns = sum(map(count_forces, rig.pairs))
    is_judged = 2 <= len(names) <= MOST_CONTACTS and columns <= MOST_COLUMNS
    if len(rig.chain.arms) != 1 or not is_judged:
        return
    pairs = {pair.name: pair for pair in rig.pairs}
    sets = chain.from_iterable(combinations(names, k) for k in range(len(names) + 1))
    members = {" and ".join(f"'{name}'" for name in one) or FREE: one for one in sets}
    errors = wrench_errors(rig)
    states = ContactStates(members, pairs, errors)
    for group in states.groups(rig.state.X_WO):
        if len(group) > 1:
            yield (
                f"not distinguished by the wrench, {errors.expected:.3g} N each, with friction "
                f"up to {errors.friction:g}: {'; '.join(group)}."
            )


def wrench_errors(rig: Rig) -> WrenchErrors:
    """Errors of the wrench of a rig with one arm: noise, friction and mean forces of its scenario.

    Without sensor errors or a coefficient of friction in the scenario those of `WrenchErrors` are
    taken.

    Args:
        rig: rig of a scenario.
    """
    scenario = rig.scenario
    values: dict[str, Any] = {}
    wrist = scenario.sensors.wrist
    if wrist is not None:
        for key in ("force", "torque"):
            error = getattr(wrist, key)
            # rounding to a resolution r is uniform in a range of r: standard deviation r/√12
            size = float(np.hypot(error.noise, error.resolution / np.sqrt(12.0)))
            if size > 0.0:
                values[key] = size
    if scenario.control.friction is not None:
        values["friction"] = scenario.control.friction.mu
    if scenario.plan is None:
        forces = rig.references.overview[1].alpha_d
        values["expected"] = float(np.abs(forces).mean())
    (sensor,) = rig.state.sensors
    if sensor is not None:
        values["sensor"] = rig.state.X_WO.actInv(sensor).translation
    return WrenchErrors(**values)

"""Desired contact forces that are not there although every tick is computed: why, in words."""

import numpy as np
from pinocchio import SE3

from osc_contact.control.controller_settings import Settings
from osc_contact.control.records import TickRecords
from osc_contact.control.status import Phase
from osc_contact.spatial import Array

PATIENCE_S = 2.0  #: s of desired forces without engaged contacts, after which it is logged


class Idle:
    """Ticks with desired contact forces in which the contacts are not engaged.

    Attributes:
        waiting: whether the contacts are not engaged, so that ticks are counted.
        ticks: number in a row, up to the last one.
        logged: whether it was logged.
    """

    def __init__(self, *, waiting: bool) -> None:
        self.begin(waiting=waiting)

    def begin(self, *, waiting: bool) -> None:
        """Count from zero, where contacts are not engaged (`waiting`)."""
        self.waiting = waiting
        self.ticks = 0
        self.logged = False

    def count(self, settings: Settings, alpha_d: Array) -> bool:
        """Take in a tick without engaged contacts; returns whether this is to be logged now.

        Args:
            settings: settings of the controller. alpha_d: (r,) desired magnitudes (N).
        """
        desired = len(settings.contacts) > 0 and bool(np.any(np.asarray(alpha_d) > 0.0))
        self.ticks = self.ticks + 1 if desired else 0
        due = not self.logged and self.ticks * settings.dt > PATIENCE_S
        self.logged = self.logged or due
        return due

    def sentence(self, settings: Settings) -> str:
        """Why nothing presses; empty where no force is desired."""
        if not self.ticks:
            return ""
        return (
            f"contact forces have been desired for {self.ticks * settings.dt:.3g} s, and the "
            "contacts are not engaged: the object counts as free. At rest, off the contacts, "
            "average controller.residual_wrench() into controller.f_tare, then call "
            "controller.engage()"
        )


def explained_approaches(records: TickRecords, settings: Settings) -> str:
    """Which approached contacts push no more than friction of the closed ones may explain.

    Args:
        records: `TickRecords` of the last tick. settings: settings of the controller.
    """
    if settings.life is None:
        return ""
    life = settings.life
    owners = records.model.columns.contact
    found = []
    for number, pair in enumerate(settings.contacts):
        if records.memory.contacts.phase[number] != Phase.APPROACHING:
            continue
        columns = records.memory.columns[owners == number]
        for row in columns:
            least = row.explained + life.force_on
            if row.explained > 0.0 and life.force_on < row.touch < least:
                found.append(
                    f"contact '{pair.name}' is not made: it reads {row.touch:.3g} N, of which "
                    f"friction of the closed contacts explains {row.explained:.3g} N if their "
                    f"coefficient is friction_bound = {life.friction_bound:g}; it is made above "
                    f"{least:.3g} N. Press more, press less on the others, or lower friction_bound "
                    "(PhaseSettings, control.life)"
                )
    return "; ".join(found)


def standing_approaches(records: TickRecords, settings: Settings) -> str:
    """Sentence on approaches that ended after `travel` without contact, with the remaining gap.

    Args:
        records: `TickRecords` of the last tick. settings: settings of the controller.
    """
    if settings.life is None:
        return ""
    travel = settings.life.travel
    X_WO = SE3(records.work.X_WO)
    found = []
    rows = zip(settings.contacts, records.memory.contacts, records.work.bodies.motion, strict=False)
    for pair, contact, motion in rows:
        if contact.phase != Phase.APPROACHING or contact.since * settings.life.speed < travel:
            continue
        X_WE = SE3(motion[:16].reshape(4, 4)) if records.work.moving else None
        gap: Array = np.abs(pair.gaps(X_WO, X_WE))
        found.append(
            f"the approach of contact '{pair.name}' has covered travel = {1e3 * travel:g} mm, met "
            f"nothing and stands still; in the model {1e3 * gap.max():.3g} mm are left. Correct "
            "the place of what it touches, begin nearer, or raise travel (PhaseSettings, "
            "control.life)"
        )
    return "; ".join(found)

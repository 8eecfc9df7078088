"""Sentences on desired contact forces that are absent although every tick is computed."""

import numpy as np
from pinocchio import SE3

from osc_contact.control.controller_settings import Settings
from osc_contact.control.records import TickRecords
from osc_contact.control.status import Phase
from osc_contact.spatial import Array

#: Time of desired forces without engaged contacts, after which a warning is logged (s).
PATIENCE_S = 2.0


class Idle:
    """Count of consecutive ticks with desired contact forces while contacts are not engaged.

    Attributes:
        waiting: True while the contacts are not engaged, so that ticks are counted.
        ticks: number of consecutive ticks, up to the last one.
        logged: True once the warning was logged.
    """

    def __init__(self, *, waiting: bool) -> None:
        """Begin to count, see `begin`."""
        self.begin(waiting=waiting)

    def begin(self, *, waiting: bool) -> None:
        """Begin to count at zero.

        Args:
            waiting: True if the contacts are not engaged.
        """
        self.waiting = waiting
        self.ticks = 0
        self.logged = False

    def count(self, settings: Settings, alpha_d: Array) -> bool:
        """Count a tick without engaged contacts; return True if the warning is to be logged now.

        A tick without a desired force sets `ticks`, the count, to zero. The warning is due once,
        after `PATIENCE_S`.

        Args:
            settings: settings of the controller.
            alpha_d: (r,) desired contact forces (N).
        """
        desired = len(settings.contacts) > 0 and bool(np.any(np.asarray(alpha_d) > 0.0))
        self.ticks = self.ticks + 1 if desired else 0
        is_overdue = not self.logged and self.ticks * settings.dt > PATIENCE_S
        self.logged = self.logged or is_overdue
        return is_overdue

    def sentence(self, settings: Settings) -> str:
        """Sentence on forces that are desired without engaged contacts; empty without such forces.

        Args:
            settings: settings of the controller, with its period.
        """
        if not self.ticks:
            return ""
        return (
            f"contact forces have been desired for {self.ticks * settings.dt:.3g} s, and the "
            "contacts are not engaged: the object counts as free. At rest, off the contacts, "
            "average controller.residual_wrench() into controller.f_tare, then call "
            "controller.engage()"
        )


def explained_approaches(records: TickRecords, settings: Settings) -> str:
    """Sentence on approached contacts whose readings friction of closed contacts may explain.

    Friction of the closed contacts changes the readings in the direction of an approached contact;
    this contact counts as made only above the part that friction explains.

    Args:
        records: `TickRecords` of the last tick.
        settings: settings of the controller.
    """
    if settings.life is None:
        return ""
    life = settings.life
    contact_of_column = records.model.columns.contact
    sentences = []
    for number, pair in enumerate(settings.contacts):
        if records.memory.contacts.phase[number] != Phase.APPROACHING:
            continue
        columns = records.memory.columns[contact_of_column == number]
        for row in columns:
            least_force = row.explained + life.force_on
            if row.explained > 0.0 and life.force_on < row.touch < least_force:
                sentences.append(
                    f"contact '{pair.name}' is not made: it reads {row.touch:.3g} N, of which "
                    f"friction of the closed contacts explains {row.explained:.3g} N if their "
                    f"coefficient is friction_bound = {life.friction_bound:g}; it is made above "
                    f"{least_force:.3g} N. Press more, press less on the others, or lower "
                    "friction_bound (PhaseSettings, control.life)"
                )
    return "; ".join(sentences)


def standing_approaches(records: TickRecords, settings: Settings) -> str:
    """Sentence on approaches that ended after `travel` (m) without contact, with the remaining gap.

    Args:
        records: records of the last tick.
        settings: settings of the controller.

    Returns:
        One sentence for each contact that is still approached after `travel` divided by the
        approach speed, joined; "" if there are none, or without contact phases.
    """
    if settings.life is None:
        return ""
    travel = settings.life.travel
    X_WO = SE3(records.work.X_WO)
    sentences = []
    rows = zip(settings.contacts, records.memory.contacts, records.work.bodies.motion, strict=False)
    for pair, contact, motion in rows:
        if contact.phase != Phase.APPROACHING or contact.since * settings.life.speed < travel:
            continue
        X_WE = SE3(motion[:16].reshape(4, 4)) if records.work.moving else None
        gap: Array = np.abs(pair.gaps(X_WO, X_WE))
        sentences.append(
            f"the approach of contact '{pair.name}' has covered travel = {1e3 * travel:g} mm, met "
            f"nothing and stands still; in the model {1e3 * gap.max():.3g} mm are left. Correct "
            "the place of what it touches, begin nearer, or raise travel (PhaseSettings, "
            "control.life)"
        )
    return "; ".join(sentences)

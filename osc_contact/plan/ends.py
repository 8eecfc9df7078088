"""Conditions for the end of a stage: made, lost, recognised, moved, pressed, at rest, finished.

Conditions are joined by & and |, and `lasting` requires them for some time:
`pressed(7.0, [0, 0, -1]) & at_rest()).lasting(0.5)`. A function of the tick's signals that returns
a truth value is a condition, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from osc_contact.control.status import Phase
from osc_contact.errors import InvalidInputError
from osc_contact.plan.arguments import Direction, Place
from osc_contact.plan.sensed import Sensed
from osc_contact.recognition.recogniser import SURE
from osc_contact.settings.quantities import AngularVelocity, Force, Length, Time, Velocity
from osc_contact.spatial import Array, as_array, unit_vector

#: Condition under way: whether it is met, by the signals of a tick and the control period (s).
Watch = Callable[[Sensed, float], bool]
MADE_FOR = 0.05  #: s for which contacts must be closed before they count as made
ORIGIN: Array = np.zeros(3)  #: origin of the object's frame (m)


@dataclass(frozen=True)
class End:
    """Condition for the end of a stage.

    Attributes:
        begin: function that begins to watch when the stage begins; returns a function of each
            tick's signals and the control period (s) that is true when the condition is met.
        words: the condition in words, for verdicts.
        contacts: names of the contacts that the condition depends on.
        states: names of the contact states that it depends on; None: it needs no recogniser.
    """

    begin: Callable[[Sensed], Watch]
    words: str
    contacts: tuple[str, ...] = ()
    states: tuple[str, ...] | None = None

    def __and__(self, other: End) -> End:
        """Condition that this one and another are met in the same tick."""
        return _join_conditions(self, other, all, "and")

    def __or__(self, other: End) -> End:
        """Condition that this one or another is met."""
        return _join_conditions(self, other, any, "or")

    def lasting(self, seconds: float) -> End:
        """Condition that this one is met for some time without interruption.

        The time begins again at zero whenever the condition is not met in a tick.

        Args:
            seconds: least time (s).
        """

        def begin(signals: Sensed) -> Watch:
            """Begin to watch this condition (`self`), with a time of zero.

            Args:
                signals: signals when the stage begins.

            Returns:
                Function of the signals of a tick and the period: whether it is met for `seconds`.
            """
            watch = self.begin(signals)
            met_for = 0.0

            def met(signals: Sensed, dt: float) -> bool:
                """Add a period to the time if the condition is met, else begin again at zero.

                Args:
                    signals: signals after the last tick.
                    dt: control period (s).

                Returns:
                    Whether the condition, watched by `watch`, has been met for `seconds` (s)
                    without interruption.
                """
                nonlocal met_for
                met_for = met_for + dt if watch(signals, dt) else 0.0
                return met_for >= seconds

            return met

        return replace(self, begin=begin, words=f"{self.words} for {seconds:g} s")


def _join_conditions(
    left: End, right: End, rule: Callable[[tuple[bool, bool]], bool], word: str
) -> End:
    """Join two conditions, both of which are evaluated in each tick.

    Args:
        left, right: the conditions.
        rule: `all` or `any`, applied to both results.
        word: "and" or "or", for verdicts.
    """

    def begin(signals: Sensed) -> Watch:
        """Begin to watch both conditions, `left` and `right`.

        Args:
            signals: signals when the stage begins.

        Returns:
            Function of the signals of a tick and the period: whether the joined condition is met.
        """
        left_watch = left.begin(signals)
        right_watch = right.begin(signals)

        def met(signals: Sensed, dt: float) -> bool:
            """Evaluate both conditions, because each may count time, and join the results.

            Args:
                signals: signals after the last tick.
                dt: control period (s).

            Returns:
                Whether both are met (`rule` is `all`), or one of them (`any`).
            """
            left_met = left_watch(signals, dt)
            right_met = right_watch(signals, dt)
            return rule((left_met, right_met))

        return met

    states = None
    if left.states is not None or right.states is not None:
        states = (*(left.states or ()), *(right.states or ()))
    words = f"{left.words} {word} {right.words}"
    return End(begin, words, (*left.contacts, *right.contacts), states)


def when(test: Callable[[Sensed], bool], words: str = "") -> End:
    """Condition that a function of a tick's signals returns True.

    Args:
        test: function of the signals that returns whether the condition is met.
        words: words for verdicts; empty: the function's name.
    """

    def begin(signals: Sensed) -> Watch:
        """Begin to watch; the function has no memory."""
        return lambda signals, dt: bool(test(signals))

    return End(begin, words or getattr(test, "__name__", "?"))


def as_end(condition: End | Callable[[Sensed], bool]) -> End:
    """Return a condition itself, or make one of a function of the signals.

    Args:
        condition: value of `until` or `unless` of a stage.

    Raises:
        InvalidInputError: the value is neither a condition nor a function.
    """
    if isinstance(condition, End):
        return condition
    if not callable(condition):
        raise InvalidInputError(
            f"until={condition!r}; give a condition such as ends.made('face') or ends.after(0.5), "
            "or a function of the signals"
        )
    return when(condition)


def made(*contacts: str, lasting: Time = MADE_FOR) -> End:
    """Condition that all these contacts are closed.

    Args:
        contacts: names of the contacts.
        lasting: time for which they must be closed without interruption (s).
    """

    def all_closed(signals: Sensed) -> bool:
        """Return whether all these contacts are closed in a tick."""
        return all(signals.phases[name] == Phase.CLOSED for name in contacts)

    end = when(all_closed).lasting(lasting)
    return End(end.begin, f"{' and '.join(contacts)} made", contacts)


def lost(*contacts: str, lasting: Time = MADE_FOR) -> End:
    """Condition that one of these contacts is not closed, or closed for moments only.

    Args:
        contacts: names of the contacts.
        lasting: time for which one must not be closed, except for less than `MADE_FOR` at a time
            (s).
    """

    def begin(signals: Sensed) -> Watch:
        """Begin to watch `contacts` (names), with times of zero for each of them.

        Args:
            signals: signals when the stage begins.

        Returns:
            Function of the signals of a tick and the period: whether a contact is lost.
        """
        closed_for = dict.fromkeys(contacts, 0.0)
        lost_for = dict.fromkeys(contacts, 0.0)

        def met(signals: Sensed, dt: float) -> bool:
            """Update the times of each contact by a period, and compare the longest loss.

            The time of a loss (s), compared with `lasting`, grows until the contact has been closed
            for `MADE_FOR` (s) without interruption.

            Args:
                signals: signals after the last tick.
                dt: control period (s).
            """
            for name in contacts:
                is_closed = signals.phases[name] == Phase.CLOSED
                closed_for[name] = closed_for[name] + dt if is_closed else 0.0
                lost_for[name] = 0.0 if closed_for[name] >= MADE_FOR else lost_for[name] + dt
            return max(lost_for.values()) >= lasting

        return met

    return End(begin, f"{' or '.join(contacts)} lost", contacts)


def recognised(*states: str, probability: float = SURE) -> End:
    """Condition that the contact state is one of those named, by the plan's recogniser.

    Args:
        states: names of states of the recogniser.
        probability: least probability of these states together.
    """

    def is_recognised(signals: Sensed) -> bool:
        """Return whether the states are probable enough in a tick."""
        return (
            signals.recogniser is not None
            and signals.recogniser.probability(*states) >= probability
        )

    end = when(is_recognised, f"{' or '.join(states)} recognised")
    return replace(end, states=states)


def unexpected() -> End:
    """Condition that a contact is closed that the stage does not assume, see `Plan`.

    It is meant for `unless`; the verdict on the stage names the state.
    """
    return replace(when(lambda signals: signals.unexpected != "", "unexpected contact"), states=())


def moved(
    distance: Length,
    direction: Direction | None = None,
    *,
    point: Place = ORIGIN,
    since: str | None = None,
) -> End:
    """Condition that a point of the object has moved.

    Args:
        distance: least distance (m).
        direction: (3,) direction along which the distance is measured, in world axes; None: the
            straight distance.
        point: (3,) point in the object's frame (m).
        since: name of the stage from whose end on the distance is measured; None: from the
            beginning of the present stage.
    """
    p = as_array("moved: point", point, (3,))
    axis = None if direction is None else unit_vector("moved: direction", direction)

    def has_moved(signals: Sensed) -> bool:
        """Return whether the point has moved by the distance in a tick.

        Args:
            signals: signals after the last tick.
        """
        displacement = signals.X.act(p) - signals.where_ended(since).act(p)
        if axis is None:
            return float(np.linalg.norm(displacement)) >= distance
        return float(axis @ displacement) >= distance

    return when(has_moved, f"moved by {1e3 * distance:g} mm")


def pressed(force: Force, on: str | Direction) -> End:
    """Condition that the object presses with at least some force.

    Args:
        force: least measured force (N); along a direction it contains the inertial force of an
            accelerated object.
        on: name of a contact, or direction (3,) of the force in world axes.
    """
    if isinstance(on, str):
        name = on
        end = when(lambda signals: signals.forces[name] >= force, f"{force:g} N on {name}")
        return End(end.begin, end.words, (name,))
    axis = unit_vector("pressed: on", on)
    return when(lambda signals: float(axis @ signals.wrench[:3]) >= force, f"{force:g} N")


def at_rest(speed: Velocity = 1e-3, rate: AngularVelocity = 0.02) -> End:
    """Condition that the object rests.

    Args:
        speed: speed of its origin below which it rests (m/s).
        rate: angular speed below which it rests (rad/s).
    """

    def rests(signals: Sensed) -> bool:
        """Return whether both speeds are below their limits in a tick.

        Args:
            signals: signals after the last tick.
        """
        linear = float(np.linalg.norm(signals.V[:3]))
        angular = float(np.linalg.norm(signals.V[3:]))
        return linear < speed and angular < rate

    return when(rests, "at rest")


def after(seconds: Time) -> End:
    """Condition that some time (s) has passed since the stage began, without pauses."""
    return when(lambda signals: signals.t >= seconds, f"after {seconds:g} s")


def finished() -> End:
    """Condition that the motion of the stage has reached its end."""
    return when(lambda signals: signals.finished, "motion finished")

"""Conditions for the end of a stage: made, lost, moved, pressed, at rest, after, finished.

Conditions are joined by & and |, and `lasting` requires them for some time:
`pressed(7.0, [0, 0, -1]) & at_rest()).lasting(0.5)`. A function of the tick's signals that returns
a truth value is a condition, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from osc_contact.control.status import Phase
from osc_contact.errors import InvalidInputError
from osc_contact.plan.sensed import Sensed
from osc_contact.spatial import Array, as_array, unit_vector

#: Condition under way: whether it is met, by the signals of a tick and the control period (s).
Watch = Callable[[Sensed, float], bool]
MADE_FOR = 0.05  #: s for which contacts must be closed before they count as made
ORIGIN: Array = np.zeros(3)


@dataclass(frozen=True)
class End:
    """Condition for the end of a stage.

    Attributes:
        begin: begins to watch; returns the condition under way.
        words: the condition in words, for verdicts.
        contacts: names of the contacts of which it speaks.
    """

    begin: Callable[[Sensed], Watch]
    words: str
    contacts: tuple[str, ...] = ()

    def __and__(self, other: End) -> End:
        """Condition that both are met in the same tick."""
        return _joined(self, other, all, "and")

    def __or__(self, other: End) -> End:
        """Condition that one of both is met."""
        return _joined(self, other, any, "or")

    def lasting(self, seconds: float) -> End:
        """Condition that this one is met for some time without interruption (s)."""

        def begin(now: Sensed) -> Watch:
            watch = self.begin(now)
            held = 0.0

            def met(now: Sensed, dt: float) -> bool:
                nonlocal held
                held = held + dt if watch(now, dt) else 0.0
                return held >= seconds

            return met

        return End(begin, f"{self.words} for {seconds:g} s", self.contacts)


def _joined(one: End, two: End, rule: Callable[[tuple[bool, bool]], bool], word: str) -> End:
    def begin(now: Sensed) -> Watch:
        watches = (one.begin(now), two.begin(now))

        def met(now: Sensed, dt: float) -> bool:
            first, second = (watch(now, dt) for watch in watches)
            return rule((first, second))

        return met

    return End(begin, f"{one.words} {word} {two.words}", (*one.contacts, *two.contacts))


def when(test: Callable[[Sensed], bool], words: str = "") -> End:
    """Condition of one's own.

    Args:
        test: whether it is met, by the signals of a tick.
        words: words for verdicts; empty: the function's name.
    """
    return End(lambda now: lambda now, dt: bool(test(now)), words or getattr(test, "__name__", "?"))


def as_end(condition: End | Callable[[Sensed], bool]) -> End:
    """Condition of a stage, which may be given as a function of the signals.

    Raises:
        InvalidInputError: neither a condition nor a function.
    """
    if isinstance(condition, End):
        return condition
    if not callable(condition):
        raise InvalidInputError(
            f"until={condition!r}; give a condition such as ends.made('face') or ends.after(0.5), "
            "or a function of the signals"
        )
    return when(condition)


def made(*contacts: str, lasting: float = MADE_FOR) -> End:
    """All these contacts are closed.

    Args:
        contacts: their names.
        lasting: s for which they must be closed.
    """

    def test(now: Sensed) -> bool:
        return all(now.phases[name] == Phase.CLOSED for name in contacts)

    words = f"{' and '.join(contacts)} made"
    end = End(lambda now: lambda now, dt: test(now), words, contacts)
    return _renamed(end.lasting(lasting), words)


def lost(*contacts: str, lasting: float = MADE_FOR) -> End:
    """One of these contacts is not closed, or closed for moments only.

    Args:
        contacts: their names.
        lasting: s for which it must not be closed, except for less than 50 ms at a time.
    """

    def begin(now: Sensed) -> Watch:
        held = dict.fromkeys(contacts, 0.0)
        lost_for = dict.fromkeys(contacts, 0.0)

        def met(now: Sensed, dt: float) -> bool:
            for name in contacts:
                closed = now.phases[name] == Phase.CLOSED
                held[name] = held[name] + dt if closed else 0.0
                lost_for[name] = 0.0 if held[name] >= MADE_FOR else lost_for[name] + dt
            return max(lost_for.values()) >= lasting

        return met

    return End(begin, f"{' or '.join(contacts)} lost", contacts)


def _renamed(end: End, words: str) -> End:
    return End(end.begin, words, end.contacts)


def moved(
    distance: float,
    direction: ArrayLike | None = None,
    *,
    point: ArrayLike = ORIGIN,
    since: str | None = None,
) -> End:
    """A point of the object has moved.

    Args:
        distance: m.
        direction: (3,) along which it is measured, in the world; None: the straight distance.
        point: (3,) in the object (m).
        since: name of the stage at whose end it began to count; None: the beginning of this one.
    """
    p = as_array("moved: point", point, (3,))
    d = None if direction is None else unit_vector("moved: direction", direction)

    def test(now: Sensed) -> bool:
        way = now.X.act(p) - now.where_ended(since).act(p)
        return float(np.linalg.norm(way) if d is None else d @ way) >= distance

    return when(test, f"moved by {1e3 * distance:g} mm")


def pressed(force: float, on: str | ArrayLike) -> End:
    """The object presses with at least some force.

    Args:
        force: N.
        on: name of a contact, or direction (3,) of the force in the world.
    """
    if isinstance(on, str):
        name = on
        end = when(lambda now: now.forces[name] >= force, f"{force:g} N on {name}")
        return End(end.begin, end.words, (name,))
    d = unit_vector("pressed: on", on)
    return when(lambda now: float(d @ now.wrench[:3]) >= force, f"{force:g} N")


def at_rest(speed: float = 1e-3, rate: float = 0.02) -> End:
    """The object rests.

    Args:
        speed: below which its origin rests (m/s).
        rate: below which it does not turn (rad/s).
    """

    def test(now: Sensed) -> bool:
        moving = float(np.linalg.norm(now.V[:3]))
        turning = float(np.linalg.norm(now.V[3:]))
        return moving < speed and turning < rate

    return when(test, "at rest")


def after(seconds: float) -> End:
    """Some time has passed since the stage began, without pauses (s)."""
    return when(lambda now: now.t >= seconds, f"after {seconds:g} s")


def finished() -> End:
    """The motion of the stage has reached its end."""
    return when(lambda now: now.finished, "motion finished")

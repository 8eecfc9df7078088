"""Stages of a plan, and the verdict on each stage that was passed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf

import pinocchio as pin

from osc_contact.errors import InvalidInputError
from osc_contact.plan.ends import End, as_end
from osc_contact.plan.motions import Motion, dwell
from osc_contact.plan.sensed import Sensed
from osc_contact.settings.quantities import Force, Time


@dataclass(frozen=True)
class Stage:
    """Stage of a plan: contacts with their forces, a motion, and a condition that ends both.

    Attributes:
        name: name, unique in its plan.
        forces: the active contacts by name, with the force of each (N), distributed evenly over its
            columns of N, or a force for each column. With a force of 0 a contact is active, too.
        motion: motion of the object, as far as these contacts permit it.
        until: condition that ends the stage, or a function of the signals.
        unless: condition with which the stage has failed.
        within: time after which the stage has failed (s).
        then: name of the stage that follows; None: the next one of the plan, after the last one the
            plan is done.
        fails: name of the stage that follows a failure; None: the plan has failed.
        largest: measured force (N) above which the stage has failed; inf: only that of the plan.
        reentry: whether a plan that was stopped may begin again with this stage.
        places: from this stage on, poses of the touched bodies of some contacts, for example of a
            hole that was found. Pairs are made in the frame of their body, without a place in the
            world's.
        may_touch: names of pairs that may be closed besides those with forces, for the recogniser
            of a plan.
        tare: whether the wrist readings of the stage, which has no contacts, are zeroed at its end.

    Example:
        >>> from osc_contact.plan import ends
        >>> stage = osc.Stage("press", {"table": 8.0}, until=ends.after(2.0), within=5.0)
        >>> print(stage.name, stage.forces)
        press {'table': 8.0}
    """

    name: str
    forces: Mapping[str, float | Sequence[float]] = field(default_factory=dict)
    motion: Motion = field(default_factory=dwell)
    until: End | Callable[[Sensed], bool] = field(kw_only=True)
    within: Time = field(kw_only=True)
    unless: End | Callable[[Sensed], bool] | None = field(default=None, kw_only=True)
    then: str | None = field(default=None, kw_only=True)
    fails: str | None = field(default=None, kw_only=True)
    largest: Force = field(default=inf, kw_only=True)
    reentry: bool = field(default=False, kw_only=True)
    places: Mapping[str, pin.SE3 | Callable[[Sensed], pin.SE3]] = field(
        default_factory=dict, kw_only=True
    )
    tare: bool = field(default=False, kw_only=True)
    may_touch: Sequence[str] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        """Make conditions of functions in `until` and `unless`, and check the fields.

        Raises:
            InvalidInputError: a field has another type, or a limit is not positive.
        """
        object.__setattr__(self, "until", as_end(self.until))
        if self.unless is not None:
            object.__setattr__(self, "unless", as_end(self.unless))
        if not isinstance(self.motion, Motion):
            raise InvalidInputError(
                f"stage {self.name!r}: motion={self.motion!r}; give a motion such as "
                "motions.along([1, 0, 0], speed=0.01)"
            )
        if self.tare and self.forces:
            raise InvalidInputError(
                f"stage {self.name!r} zeroes the wrist readings and has contacts; give it no forces"
            )
        for key in ("within", "largest"):
            if not getattr(self, key) > 0.0:
                raise InvalidInputError(
                    f"stage {self.name!r}: {key} = {getattr(self, key)!r}; give a number > 0"
                )


@dataclass
class StageVerdict:
    """Verdict on a stage that was passed.

    Attributes:
        name: name of the stage.
        begin: time in the plan at which it began (s).
        duration: s.
        peak: largest measured force on what the object touches, low-passed with 5 ms (N).
        rms: rms error of the forces of its closed contacts (N).
        ended_by: condition that ended it, or why it failed.
        unexpected: the first state that was recognised in it and that it does not assume; empty
            without one.
        failed: whether it failed.

    Example:
        >>> verdict = osc.StageVerdict("press", 0.0, 0.3, peak=9.1, rms=0.2, ended_by="after 0.3 s")
        >>> print(verdict.name, verdict.peak, verdict.failed)
        press 9.1 False
    """

    name: str
    begin: float
    duration: float = 0.0
    peak: float = 0.0
    rms: float = 0.0
    ended_by: str = ""
    failed: bool = False
    unexpected: str = ""

    def __str__(self) -> str:
        """One line for a report."""
        return (
            f"{self.name}: {self.duration:.2f} s, peak {self.peak:.1f} N, rms {self.rms:.2f} N, "
            f"{'failed: ' if self.failed else ''}{self.ended_by}"
        )

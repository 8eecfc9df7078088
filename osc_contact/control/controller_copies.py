"""A controller that goes on elsewhere: with other gains or laws, as a copy, from a pickle."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any, Self

import numpy as np

from osc_contact.control.controller_state import ControllerState
from osc_contact.control.laws import Laws
from osc_contact.control.outside import Outside
from osc_contact.control.settings import Settings
from osc_contact.control.tick_records import TickRecords
from osc_contact.errors import OscContactError
from osc_contact.law import tick as law
from osc_contact.scenarios.control_schema import Gains, SafetySettings
from osc_contact.spatial import Array

__all__ = ["ControllerCopies"]


class ControllerCopies(ControllerState):
    """Ways of making another `Controller` that continues from this one; they share nothing."""

    _outside: Outside
    _still: Array
    _begin: Callable[..., None]
    _run: Callable[..., int]

    def with_gains(self, gains: Gains) -> Self:
        """Another controller with these gains that goes on from here without a jump.

        The force integral is a force and stays. What the motion integral commands stays too: ∫e is
        scaled by the old gain over the new one, or handed to `f_bias` if the new one is 0.
        """
        settings = replace(self.settings, gains=gains)
        other = self._another(settings, self.laws)
        other._records.row.set_gains(settings)
        before, after = self.gains.motion.integral, gains.motion.integral
        if after > 0.0:
            other.motion_law.integral = self.motion_law.integral * (before / after)
        elif self._records.memory.ticked:
            self._copy_work(other)
            other._records.row.head.integral = before
            other._hand_over()
            other._records.row.head.integral = 0.0
        contacts = other._records.contacts
        if self.settings.phases is None:
            contacts.gain[:], contacts.damping[:] = gains.force.integral, gains.force.damping
            contacts.brake[:] = gains.force.brake
        return other

    def with_safety(self, safety: SafetySettings) -> Self:
        """Another controller with these limits of the robot that goes on from here."""
        settings = replace(self.settings, safety=safety)
        other = self._another(settings, self.laws)
        other._records.row.set_safety(settings)
        return other

    def with_laws(self, **laws: Callable[..., Any] | None) -> Self:
        """Another controller that goes on from here with laws of the user's own, see `Laws`."""
        return self._another(self.settings, replace(self.laws, **laws))

    def _another(self, settings: Settings, laws: Laws) -> Self:
        other = type(self).__new__(type(self))
        same = settings is self.settings and laws is self.laws
        outside = self._outside if same else None  # it packs rows anew, by its settings
        records = TickRecords(self._records.row)
        records.memory_bytes[:] = self._records.memory_bytes
        records.status[0] = 0
        other._begin(settings, laws, records, outside)
        other._begin_start(deepcopy(self._start), self._starting)
        return other

    def _copy_work(self, other: Self) -> None:
        other._records.work_bytes[:] = self._records.work_bytes

    def __copy__(self) -> Self:
        other = self._another(self.settings, self.laws)
        self._copy_work(other)
        other._given_up, other._failure, other._inputs = self.given_up, self._failure, self._inputs
        other._codes[0] = self._codes[0]
        return other

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self.__copy__()

    def __getstate__(self) -> dict[str, Any]:
        r = self._records
        return {
            "settings": self.settings, "laws": self.laws, "columns": dict(r.row.pairs.given),
            "memory": r.memory_bytes, "work": r.work_bytes, "code": int(self._codes[0]),
            "given_up": self.given_up, "inputs": self._inputs,
            "start": (self._start, self._starting),
            "failure": None if self._failure is None else str(self._failure),
        }  # fmt: skip

    def __setstate__(self, state: dict[str, Any]) -> None:
        outside = Outside(state["settings"], state["laws"])
        row = outside.pack(state["columns"])
        records = TickRecords(row)
        records.memory_bytes[:] = state["memory"]
        self._begin(state["settings"], state["laws"], records)
        self._records.work_bytes[:] = state["work"]
        self._begin_start(*state["start"])
        self._codes[0], self._given_up = state["code"], state["given_up"]
        self._inputs, why = state["inputs"], state["failure"]
        self._failure = None if why is None else OscContactError(why)

    def _hand_over(self) -> None:
        zeros, six = np.zeros(self.chain.nq), np.zeros(6)
        given = zeros, zeros, np.zeros((self._arms, 6)), np.eye(4), six, six, np.zeros(0)
        self._run((*given, self._still), begin=law.HAND_OVER)

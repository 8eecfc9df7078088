"""What a run keeps of every tick: raw numbers, copied into rows that are allocated once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.control.controller import Controller
from osc_contact.control.life import Phase
from osc_contact.control.result import TickResult, internal_forces
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference
from osc_contact.plants.judge import Judge
from osc_contact.spatial import Array

__all__ = ["Log", "Subject"]

#: What of `TickResult` is kept, and how many numbers that is.
FOUND = {
    "f_meas": 6, "bias_out": 6, "V_O": 6, "X_WO": 16, "f_c": 6, "error": 6, "free_error": 6,
    "squeeze": 1,
}  # fmt: skip


@dataclass(frozen=True)
class Subject:
    """What is recorded.

    Attributes:
        controller: whose ticks are noted.
        pairs: the true contacts. placements: X_WB of the body of each at the start.
        owners: (r,) the contact of each force magnitude.
        free: whether the arms can move the object in all six directions.
    """

    controller: Controller
    pairs: tuple[ContactPair, ...]
    placements: tuple[pin.SE3, ...]
    owners: Array
    free: bool

    @cached_property
    def pushing(self) -> NDArray[np.bool_]:
        """(r,) whether each force magnitude must not become negative."""
        return np.array([pushes_only(self.pairs[i]) for i in self.owners], dtype=bool)


class Log:
    """Rows of a run; `channels.channels` makes a recording of them.

    Attributes:
        of: what is recorded. count: ticks noted.
        truth: the judge's own log of the same ticks; None: there is no judge.
        phase: (ticks, contacts) of contact life, where there is one. seen: (2, ticks, r) its
            monitor's contacts and collisions.
        given_up: (ticks, r) contact forces that the motor limits cost.
    """

    def __init__(self, of: Subject, judge: Judge | None, ticks: int) -> None:
        """Make room for ticks.

        Args:
            of: what is recorded. judge: what knows the truth; None: nothing does.
            ticks: how many there is room for; more is made for more.
        """
        controller, r = of.controller, len(of.owners)
        chain, contacts = controller.chain, len(of.pairs)
        self.of = of
        self.count = 0
        self.truth = None if judge is None else judge.log(ticks)
        self._ends: list[tuple[float, int, bool, float | Array]] = []
        self.given_up = np.zeros((ticks, r))
        lived = 0 if controller.life is None else ticks
        self.phase = np.zeros((lived, contacts), dtype=np.int64)
        self.seen = np.zeros((2, lived, r), dtype=bool)
        sizes = {"q": chain.nq, "v": chain.nq, "tau": chain.n_a, "alpha_d": r,
                 "alpha": r, "speed": r, **FOUND}  # fmt: skip
        sizes["squeeze"] = internal_forces(len(chain.arms))
        if not of.free:  # what the arms can make of an error is to be told
            sizes["J"] = 6 * chain.nq
        self._still = np.tile(np.eye(4), (contacts, 1, 1)).ravel()
        if self.truth is None:
            sizes["X_WE"] = len(self._still)
        else:
            sizes["truth"] = sum(part.size for part in self.truth.parts)
        ends = np.cumsum([0, *sizes.values()])
        self._places = dict(zip(sizes, map(slice, ends[:-1], ends[1:]), strict=True))
        self._rows = np.zeros((ticks, ends[-1]))
        self._of_found = tuple(name for name in sizes if name in FOUND or name == "J")
        self._r = r
        self._last: TickResult | None = None

    def __contains__(self, name: str) -> bool:
        return name in self._places

    def rows(self, name: str, start: int, stop: int) -> Array:
        """(stop − start, numbers) of q, v, tau, alpha_d; of alpha and speed, measured magnitudes
        and NᵀV_rel of all contact forces, 0 where none are measured; of a field of `TickResult`;
        of truth, or where no judge knows it of X_WE, measured poses of the touched bodies."""
        return self._rows[start:stop, self._places[name]]

    def ends(self, start: int, stop: int) -> tuple[Array, Array, Array]:
        """How ticks ended: what each took (s), its status, the phase of each contact."""
        spent, status, engaged, _ = zip(*self._ends[start:stop], strict=True)
        phase = self.phase[start:stop]
        if not len(self.phase):
            all_of_them = np.where(np.array(engaged), Phase.CLOSED, Phase.OPEN)
            phase = np.repeat(all_of_them[:, None], self.phase.shape[1], axis=1).astype(np.int64)
        return np.array(spent), np.array(status, dtype=np.int64), phase

    def squeeze_d(self, start: int, stop: int) -> Array:
        """(stop − start,) desired internal force, or one for each two grasps."""
        return np.array([end[3] for end in self._ends[start:stop]], dtype=float)

    def note(
        self, measurement: Measurement, reference: Reference, tau: Array, spent: float
    ) -> None:
        """Keep a tick: what went in, what was found, what it took (s)."""
        controller, k = self.of.controller, self.count
        if k == len(self._rows):
            self._make_room()
        try:
            ends = measurement.q, measurement.v, tau, reference.alpha_d
            np.concatenate((*ends, *self._found(measurement)), out=self._rows[k])
        except (InvalidInputError, TypeError, ValueError):  # held: nothing to note, or misshapen
            self._rows[k] = np.nan
            self._rows[k, self._places["tau"]] = tau
            if self.truth is not None:
                truth = np.concatenate((np.zeros(0), *self.truth.parts))
                self._rows[k, self._places["truth"]] = truth
        if self.truth is not None:
            self.truth.note()
        self._ends.append((spent, controller.status, controller.engaged, reference.squeeze_d))
        if len(self.phase) and self._last is not None:
            seen = self._last.records.column_memory
            self.phase[k], self.seen[:, k] = controller.phases(), (seen.closed, seen.collision)
        cost = controller.given_up
        if cost is not None and len(cost.force) == self._r:
            self.given_up[k] = cost.force
        self.count = k + 1

    def _found(self, measurement: Measurement) -> list[Array]:
        """What the last tick found, and the judge's parts."""
        found = self.of.controller.found()
        if found is not self._last:  # compiled ticks overwrite theirs
            self._last = found
            self._parts = self._flat(found, found.magnitudes[: self._r], found.speeds[: self._r])
        parts = self._parts
        if found.rank != self._r:
            parts = self._flat(found, *found.records.spread())
        if self.truth is None:
            touched = measurement.touched
            return [*parts, self._still if touched is None else np.ravel(touched.X_WE)]
        return parts

    def _make_room(self) -> None:
        """Twice as many rows."""
        for name in ("_rows", "given_up", "phase"):
            rows = getattr(self, name)
            setattr(self, name, np.concatenate((rows, np.zeros_like(rows))))
        self.seen = np.concatenate((self.seen, np.zeros_like(self.seen)), axis=1)

    def _flat(self, found: TickResult, alpha: Array, speed: Array) -> list[Array]:
        fields = (np.ravel(getattr(found, name)) for name in self._of_found)
        truth = () if self.truth is None else self.truth.parts
        return [*_joined([alpha, speed, *fields]), *truth]


def _joined(parts: list[Array]) -> list[Array]:
    """The same numbers in the same order, neighbours in memory as one array: fewer to copy."""
    out = parts[:1]
    for part in parts[1:]:
        base, end = out[-1].base, _address(out[-1]) + out[-1].nbytes
        if base is not None and base is part.base and base.ndim == 1 and end == _address(part):
            start = (_address(out[-1]) - _address(base)) // base.itemsize
            out[-1] = base[start : start + out[-1].size + part.size]
        else:
            out.append(part)
    return out


def _address(x: Array) -> int:
    return int(x.__array_interface__["data"][0])

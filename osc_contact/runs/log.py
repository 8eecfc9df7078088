"""What a run keeps of every tick: raw numbers, copied into rows, appended to a journal."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from time import perf_counter

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from osc_contact.contacts.pairs.pair import ContactPair, pushes_only
from osc_contact.control.controller import Controller
from osc_contact.control.reports import Status
from osc_contact.control.result import TickResult, internal_forces
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Measurement, Reference
from osc_contact.plants.judge import Judge
from osc_contact.recorder.journal import JournalFile
from osc_contact.recorder.memory import MemoryJournal
from osc_contact.spatial import Array

__all__ = ["BLOCK", "Log", "Subject", "blocks"]

BLOCK = 500  #: rows that the journal is handed at once, at most
_TOGETHER = 1000  #: rows whose channels are worked out together
_EVERY = 0.08  #: s; the journal is not left behind any longer

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
    """Rows of a run, in a journal; `channels.channels` makes a recording of them.

    Rows are kept for a moment, then appended to the journal, at least ten times per second.

    Attributes:
        of: what is recorded. count: ticks noted.
        truth: the judge's own log of the same ticks; None: there is no judge.
        journal: where the rows go.
    """

    def __init__(
        self, of: Subject, judge: Judge | None, journal: JournalFile | MemoryJournal
    ) -> None:
        """Lay out the rows.

        Args:
            of: what is recorded. judge: what knows the truth; None: nothing does.
            journal: where the rows go.
        """
        controller, r = of.controller, len(of.owners)
        chain, contacts = controller.chain, len(of.pairs)
        self.of, self.journal = of, journal
        self.count = self._k = 0
        self.truth = None if judge is None else judge.log(BLOCK)
        squeezes = internal_forces(len(chain.arms))
        sizes = {"q": chain.nq, "v": chain.nq, "tau": chain.n_a, "alpha_d": r,
                 "alpha": r, "speed": r, **FOUND, "squeeze": squeezes}  # fmt: skip
        if not of.free:  # what the arms can make of an error is recorded
            sizes["J"] = 6 * chain.nq
        self._still = np.tile(np.eye(4), (contacts, 1, 1)).ravel()
        if self.truth is None:
            sizes["X_WE"] = len(self._still)
        else:
            sizes["truth"] = sum(part.size for part in self.truth.parts)
        self._copied = sum(sizes.values())
        self._of_result = tuple(name for name in sizes if name in FOUND or name == "J")
        sizes |= {"tick_s": 1, "status": 1, "engaged": 1, "squeeze_d": squeezes, "given_up": r}
        if controller.life is not None:
            sizes |= {"phase": contacts, "closed": r, "collision": r}
        ends = np.cumsum([0, *sizes.values()])
        self._places = dict(zip(sizes, map(slice, ends[:-1], ends[1:]), strict=True))
        self._fields = [(name, "<f8", (size,)) for name, size in sizes.items()]
        self._rows = np.zeros((BLOCK, ends[-1]))
        self._r = r
        self.first_reason = ""  #: why the first tick that failed could not be computed
        self._last: TickResult | None = None
        self._flushed = perf_counter()

    def note(
        self, measurement: Measurement, reference: Reference, tau: Array, spent: float
    ) -> None:
        """Keep a tick: what went in, what was found, what it took (s).

        Args:
            measurement, reference: of the tick. tau: (n_a,) its torques. spent: on it (s).
        """
        self.make_room()
        controller, row, places = self.of.controller, self._rows[self._k], self._places
        try:
            ends = measurement.q, measurement.v, tau, reference.alpha_d
            parts = (*ends, *self._last_result(measurement))
            np.concatenate(parts, out=row[: self._copied])
        except (InvalidInputError, TypeError, ValueError):  # held: nothing to note, or misshapen
            row[: self._copied] = np.nan
            row[places["tau"]] = tau
            if self.truth is not None:
                row[places["truth"]] = np.concatenate((np.zeros(0), *self.truth.parts))
        if self.truth is not None:
            self.truth.note()
        row[self._copied :] = 0.0
        first, status = self._copied, controller.status
        row[first], row[first + 1], row[first + 2] = spent, status, controller.engaged
        _put_squeeze(row[places["squeeze_d"]], reference.squeeze_d)
        if status is Status.HELD and not self.first_reason:
            at = self.count * controller.dt
            self.first_reason = f"at {at:.3f} s: {controller.reason}"
        cost = controller.given_up
        if cost is not None and len(cost.force) == self._r:
            row[places["given_up"]] = cost.force
        if controller.life is not None and self._last is not None:
            seen = self._last.records
            np.multiply(seen.phase, seen.active, out=row[places["phase"]])  # OPEN is 0
            row[places["closed"]], row[places["collision"]] = seen.closed, seen.collision
        self._k += 1
        self.count += 1

    def make_room(self) -> None:
        """Flush full tables, and those that have waited long enough."""
        if self._k == BLOCK or perf_counter() - self._flushed > _EVERY:
            self.flush()

    def last(self) -> Array:
        """The row of the last tick, by itself."""
        return self._joined(self._k - 1, self._k)

    def flush(self) -> None:
        """Append to the journal what was noted since the last time."""
        if self._k:
            self.journal.append(self.count - self._k, self._joined(0, self._k))
            self._k = 0
            if self.truth is not None:
                self.truth.clear()
        self._flushed = perf_counter()

    def _joined(self, start: int, stop: int) -> Array:
        """Rows with names, and with what the judge noted beside them."""
        rows, fields = self._rows[start:stop], self._fields
        if self.truth is not None:
            noted = self.truth.noted(start, stop)
            rows = np.concatenate((rows, noted), axis=1)
            fields = [*fields, ("noted", "<f8", (noted.shape[1],))]
        return np.ndarray(stop - start, np.dtype(fields), np.ascontiguousarray(rows))

    def _last_result(self, measurement: Measurement) -> list[Array]:
        """What the last tick found, and the judge's parts."""
        result = self.of.controller.result()
        if result is not self._last:  # compiled ticks overwrite theirs
            self._last = result
            self._parts = self._flat(result, result.magnitudes[: self._r], result.speeds[: self._r])
        parts = self._parts
        if result.rank != self._r:
            parts = self._flat(result, *result.records.spread())
        if self.truth is None:
            touched = measurement.touched
            return [*parts, self._still if touched is None else np.ravel(touched.X_WE)]
        return parts

    def _flat(self, result: TickResult, alpha: Array, speed: Array) -> list[Array]:
        fields = (np.ravel(getattr(result, name)) for name in self._of_result)
        truth = () if self.truth is None else self.truth.parts
        return [*_flattened([alpha, speed, *fields]), *truth]


def blocks(parts: Iterable[tuple[int, Array]]) -> Iterator[tuple[int, Array]]:
    """Rows of a journal cut at every 1,000 ticks, wherever its chunks end.

    Args:
        parts: number of the first row, rows; in order.
    """
    begin, waiting = 0, np.zeros(0)
    for first, rows in parts:
        if len(waiting) and first != begin + len(waiting):
            yield begin, waiting
            waiting = np.zeros(0)
        if not len(waiting):
            begin, waiting = first, rows
        else:
            waiting = np.concatenate(_alike(waiting, rows))
        while (cut := _TOGETHER - begin % _TOGETHER) <= len(waiting):
            yield begin, waiting[:cut]
            begin, waiting = begin + cut, waiting[cut:]
    if len(waiting):
        yield begin, waiting


def _alike(*parts: Array) -> list[Array]:
    """Rows of one layout: where less was noted, zeros stand behind it."""
    wide = max((part.dtype for part in parts), key=lambda dtype: dtype.itemsize)
    out = []
    for part in parts:
        rows = np.zeros((len(part), wide.itemsize // 8))
        rows[:, : part.dtype.itemsize // 8] = np.ndarray(
            (len(part), part.dtype.itemsize // 8), float, np.ascontiguousarray(part)
        )
        out.append(np.ndarray(len(part), wide, rows))
    return out


def _put_squeeze(place: Array, wanted: float | Array) -> None:
    """A single number is followed by NaNs: that distinguishes it from several."""
    if isinstance(wanted, float):
        place[0] = wanted
        place[1:] = np.nan
        return
    try:
        place[:] = np.nan
        place[: np.size(wanted)] = wanted
    except (TypeError, ValueError):  # the tick was held
        place[:] = np.nan


def _flattened(parts: list[Array]) -> list[Array]:
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

"""What a run keeps of every tick: raw numbers, copied into rows that are allocated once."""

from __future__ import annotations

import numpy as np

from osc_contact.control.controller import Controller
from osc_contact.control.life import Phase
from osc_contact.control.result import TickResult, internal_forces
from osc_contact.interface import Measurement
from osc_contact.plants.plant import Plant
from osc_contact.runs.rig import Rig
from osc_contact.spatial import Array

__all__ = ["Log"]

#: What of `TickResult` is kept, and how many numbers that is.
FOUND = {
    "f_meas": 6, "bias_out": 6, "V_O": 6, "X_WO": 16, "f_c": 6, "error": 6, "free_error": 6,
    "squeeze": 1,
}  # fmt: skip


class Log:
    """Rows of a run; `channels.channels` makes a recording of them.

    Attributes:
        count: ticks noted. truth: the plant's own log of the same ticks.
        phase: (ticks, contacts) of contact life, where there is one. seen: (2, ticks, r) its
            monitor's contacts and collisions.
        given_up: (ticks, r) contact forces that the motor limits cost.
    """

    def __init__(self, rig: Rig, plant: Plant, ticks: int) -> None:
        """Make room for the ticks of a run."""
        n, n_a, r = rig.chain.nq, rig.chain.n_a, len(rig.pushing)
        self.count = 0
        self.truth = plant.log(ticks)
        self._ends: list[tuple[float, int, bool]] = []
        self.given_up = np.zeros((ticks, r))
        lived = 0 if rig.scenario.control.life is None else ticks
        self.phase = np.zeros((lived, len(rig.pairs)), dtype=np.int64)
        self.seen = np.zeros((2, lived, r), dtype=bool)
        sizes = {"q": n, "v": n, "tau": n_a, "alpha": r, "speed": r, **FOUND}
        sizes["squeeze"] = internal_forces(len(rig.chain.arms))
        if rig.d < 6:  # what the arms can make of an error is to be told
            sizes["J"] = 6 * n
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
        """(stop − start, numbers) of q, v, tau; of alpha and speed, measured magnitudes and NᵀV_rel
        of all contact forces, 0 where none are measured; of a field of `TickResult`; or truth."""
        return self._rows[start:stop, self._places[name]]

    def ends(self, start: int, stop: int) -> tuple[Array, Array, Array]:
        """How ticks ended: what each took (s), its status, the phase of each contact."""
        spent, status, engaged = zip(*self._ends[start:stop], strict=True)
        phase = self.phase[start:stop]
        if not len(self.phase):
            all_of_them = np.where(np.array(engaged), Phase.CLOSED, Phase.OPEN)
            phase = np.repeat(all_of_them[:, None], self.phase.shape[1], axis=1).astype(np.int64)
        return np.array(spent), np.array(status, dtype=np.int64), phase

    def note(
        self, controller: Controller, measurement: Measurement, tau: Array, spent: float
    ) -> None:
        """Keep a tick: what the controller was told, what it found, what it took (s)."""
        k, found = self.count, controller.found()
        if found is not self._last:  # compiled ticks overwrite theirs
            self._last = found
            self._parts = self._flat(found, found.magnitudes[: self._r], found.speeds[: self._r])
        parts = self._parts
        if found.rank != self._r:
            parts = self._flat(found, *found.records.spread())
        np.concatenate((measurement.q, measurement.v, tau, *parts), out=self._rows[k])
        self._ends.append((spent, controller.status, controller.engaged))
        if len(self.phase):
            seen = found.records.column_memory
            self.phase[k], self.seen[:, k] = controller.phases(), (seen.closed, seen.collision)
        cost = controller.given_up
        if cost is not None and len(cost.force) == self._r:
            self.given_up[k] = cost.force
        self.truth.note()
        self.count = k + 1

    def _flat(self, found: TickResult, alpha: Array, speed: Array) -> list[Array]:
        fields = (np.ravel(getattr(found, name)) for name in self._of_found)
        return [*_joined([alpha, speed, *fields]), *self.truth.parts]


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

"""The control loop on MuJoCo as one compiled function: ticks, steps and notes without Python.

It does what `run_loop` does with a plain `MujocoPlant` and a `Recorder`, in the same order and with
the same numbers. Where a tick is out of the ordinary it stops, and Python does that one.
"""

from __future__ import annotations

import time
from functools import cache
from typing import Any

import numpy as np
from numba import carray, njit, types  # type: ignore[attr-defined]

from osc_contact.law.compiled import rows as law_rows
from osc_contact.law.jit import call_entry, pointer, share_entry
from osc_contact.plants.mujoco_memory import find_places

__all__ = ["DIVERGED", "FULL", "ODD", "ROOM", "compiled_loop"]

#: Why the loop ended: rows are full, all ticks done or time is up; the tick that was just computed
#: is out of the ordinary; there is no room for the contacts' notes; MuJoCo warns.
FULL, ODD, ROOM, DIVERGED = range(4)

_CLOCK = getattr(time, "CLOCK_MONOTONIC", None)  #: None on Windows: then no loop is compiled
_clock_gettime = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))
_mj_step = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))


@njit
def _word(address):
    return carray(pointer(np.uintp(address)), (1,), types.int64)[0]


@njit
def _whole(address):
    return carray(pointer(np.uintp(address)), (1,), types.int32)[0]


@njit
def _number(address):
    return carray(pointer(np.uintp(address)), (1,), types.float64)[0]


@njit
def _now(clock):
    _clock_gettime(_CLOCK, clock.ctypes.data)
    return clock[0] + 1e-9 * clock[1]


@cache
def compiled_loop() -> Any:
    """The loop, see `_build`; None where it cannot be compiled."""
    stamp = None if share_entry is None else share_entry(law_rows())
    if stamp is None or _CLOCK is None or find_places() is None:
        return None
    return _build(stamp)


def _build(stamp: int) -> Any:
    """`stamp` tells numba's cache of a law with other arguments."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def loop(tables, plan, plant, places, notes, rows, sources, tail, flags_of, k, last, j, most):
        """Ticks k … last − 1 into rows j …, for `most` s or a tick longer.

        Returns (next tick, next row, why it ended, s that the law took in the last tick).
        """
        seconds = 0.0
        if stamp < 0:
            return k, j, FULL, seconds
        model, memory, work, codes, rank, squeeze, still, flags, r, tau = tables
        X_WD, V_D, A_D, alpha_d = plan
        qpos, qvel, sensed, ctrl, q_at, v_at, driven, spring_q, spring_v, readings = plant[:10]
        data, whole_model, blind_model, substeps, warnings = plant[10:]
        points, geoms, addresses, forces, place, frame = notes
        n = q_at.size
        q, v, wrenches = np.zeros(n), np.zeros(n), np.zeros(readings.shape)
        clock = np.zeros(2, np.int64)
        began = now = _now(clock)
        while k < last and j < len(rows) and now - began < most:
            count = _whole(data + places[0])
            if count > place.shape[1]:
                return k, j, ROOM, seconds
            first, force = _word(data + places[1]), _word(data + places[2])
            for c in range(count):
                if _whole(first + c * places[3] + places[5]) >= forces.shape[1]:
                    return k, j, ROOM, seconds
            for i in range(n):
                q[i], v[i] = qpos[q_at[i]], qvel[v_at[i]]
            for i in range(spring_q.size):
                q[driven[i]] += qpos[spring_q[i]]
                v[driven[i]] += qvel[spring_v[i]]
            for i in range(readings.shape[0]):
                for c in range(6):
                    if readings[i, c] >= 0:
                        wrenches[i, c] = sensed[readings[i, c]]
            start = _now(clock)
            done = call_entry((
                model, memory, work, q, v, wrenches, X_WD[k], V_D[k], A_D[k], alpha_d[k], squeeze,
                still, flags, tau, codes, 0, 4, 0, 1,
            ))  # fmt: skip
            now = _now(clock)
            seconds = now - start
            if done != 2 or rank[0] != r:
                return k, j, ODD, seconds
            for i in range(len(flags_of)):
                if _word(flags_of[i, 0]) != flags_of[i, 1]:
                    return k, j, ODD, seconds
            row, end = rows[j], 0
            for part in (q, v, tau, alpha_d[k]):
                for x in part:
                    row[end] = x
                    end += 1
            for i in range(len(sources)):
                for place_of_x in range(sources[i, 0], sources[i, 0] + 8 * sources[i, 1], 8):
                    row[end] = _number(place_of_x)
                    end += 1
            for i in range(tail.size):
                row[end + i] = tail[i]
            row[end] = seconds
            points[j] = count
            for c in range(count):
                here = first + c * places[3]
                for i in range(2):
                    geoms[j, c, i] = _whole(here + places[4] + 4 * i)
                addresses[j, c] = address = _whole(here + places[5])
                for i in range(3):
                    place[j, c, i] = _number(here + places[6] + 8 * i)
                for i in range(9):
                    frame[j, c, i] = _number(here + places[7] + 8 * i)
                if address >= 0:
                    forces[j, address] = _number(force + 8 * address)
            for i in range(tau.size):
                ctrl[i] = tau[i]
            for _ in range(substeps - 1):
                _mj_step(blind_model, data)
            _mj_step(whole_model, data)
            k, j = k + 1, j + 1
            for i in range(warnings.size):
                if warnings[i] != 0:
                    return k, j, DIVERGED, seconds
        return k, j, FULL, seconds

    return loop

"""Packets of encoders that repeat themselves after a stop: readings without noise, too."""

from __future__ import annotations

import numpy as np

from osc_contact.spatial import Array

#: s after a stop that released a motor, in which the arms move by a step of an encoder at least
_RELEASED_TIME = 0.05


class DeadPackets:
    """Detection of encoders of stopped arms whose packets repeat themselves.

    An arm at rest may have constant readings without noise, and so may one that a contact stops at
    once and that friction then holds. Constant readings of all joints show that their packet is
    dead after the controller has stopped the arms since motors contradict a wrist, and has thereby
    released a motor: whether its torque accelerated the arm or pressed it on a contact, which
    yields, the arm moves then. An object that is wedged would not yield.

    Estimated velocities and positions conceal repetitions: readings have to be checked before.
    """

    def __init__(self, sample: float) -> None:
        """Begin without a reading.

        Args:
            sample: period of the readings (s).
        """
        self._sample = sample
        self._last_reading: Array | None = None  #: (n,) last readings (rad, m); None: none yet
        self._repetitions = 0  #: number of readings since they last changed

    def update(self, measured: Array, released_for: float) -> bool:
        """Return whether the packets are dead after a new reading.

        Args:
            measured: (n,) new readings of the encoders (rad, m).
            released_for: `Controller.released_for` (s); 0: there was no such stop.
        """
        is_same = self._last_reading is not None and bool((measured == self._last_reading).all())
        self._last_reading = np.array(measured, dtype=float)
        self._repetitions = self._repetitions + 1 if is_same else 0
        constant_for = self._repetitions * self._sample
        return released_for >= _RELEASED_TIME and constant_for >= released_for

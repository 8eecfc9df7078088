"""Packets of encoders that repeat themselves: readings without noise, too."""

from __future__ import annotations

import numpy as np

from osc_contact.spatial import Array

#: Deceleration that friction does not cause, as a multiple of the rms unmodelled acceleration
_SUDDEN = 10.0
_LEAST_STEP = 1e-6  #: rad, m, step of an encoder that is finer
_REPEATED_TIME = 0.01  #: s for which readings repeat until their packet is dead
_FEWEST = 3  #: least number of repetitions in this time
_RELEASED_TIME = 0.05  #: s after a stop that released a motor, in which readings change


class DeadPackets:
    """Detection of packets that repeat themselves, from which velocities are estimated.

    An arm at rest may have constant readings without noise. Those of all joints prove that their
    packet is dead

    * if at least two joints would have had to stop too suddenly: one with the velocity v whose
      reading is constant from then on has stopped within one step δ of its encoder, and decelerated
      by v²/(2δ) at least;
    * if the controller has stopped the arms, and thereby released a motor: the arms then move by a
      step at least, even if a contact held them.

    Estimated velocities and positions conceal repetitions: readings have to be checked before.
    """

    def __init__(self, resolution: Array, unknown: Array, sample: float) -> None:
        """Compute the velocities with which joints cannot stop within a step of their encoders.

        Args:
            resolution: (n,) step of the readings (rad, m).
            unknown: (n,) rms unmodelled acceleration of the joints (rad/s², m/s²).
            sample: period of the readings (s).
        """
        step = np.maximum(resolution, _LEAST_STEP)
        #: (n,) velocity with which a joint stops within a step by the largest deceleration
        self._least_velocity = np.sqrt(2.0 * _SUDDEN * unknown * step)
        self._sample = sample
        self._last_reading = np.full(len(step), np.nan)  #: (n,) last readings (rad, m)
        self._velocity = np.zeros(len(step))  #: (n,) when the readings last changed (rad/s, m/s)
        self._repetitions = 0  #: number of readings since then

    def update(self, measured: Array, velocity: Array, released_for: float = 0.0) -> bool:
        """Return whether the packets are dead after a new reading.

        Args:
            measured: (n,) new readings of the encoders (rad, m).
            velocity: (n,) estimated before this reading (rad/s, m/s).
            released_for: time since a stop that released a motor (s); 0: there was none.
        """
        if (measured != self._last_reading).any():
            self._last_reading = np.array(measured, dtype=float)
            self._velocity = velocity
            self._repetitions = 0
            return False
        self._repetitions += 1
        constant_for = self._repetitions * self._sample
        if released_for >= _RELEASED_TIME and constant_for >= released_for:
            return True
        n_sudden = np.count_nonzero(np.abs(self._velocity) > self._least_velocity)
        is_long = self._repetitions >= _FEWEST and constant_for > _REPEATED_TIME
        return bool(n_sudden > 1 and is_long)

"""Contact or no contact, from the paper's own signal: projected force and power (figs. 6, 7).

While a contact holds, the power of the projected force is zero: α_k (NᵀV_rel)_k = 0. A collision
is a burst of it as a contact is made, a lost contact a force that has gone. Force is judged with
hysteresis; power only around the moment when contact is made, so that noisy velocities (faces
followed by vision) raise no alarm while it lasts.
"""

from types import SimpleNamespace

import numpy as np

from osc_contact.law import phases
from osc_contact.law.jit import as_python
from osc_contact.settings.control import MonitorLimits
from osc_contact.spatial import Array

_monitor = as_python(phases.monitor)  # one number at a time, in Python


class ContactMonitor:
    """`law.phases.monitor` of several magnitudes, tick by tick.

    Attributes:
        dt: the tick (s). limits: thresholds.
        rows: what is remembered of each magnitude: closed, collision; s since the force went low,
            or high (low_for, high_for); burst: W, the largest power since then; armed_for: s in
            which a collision may still be reported.
    """

    def __init__(self, contacts: int, dt: float) -> None:
        self.dt = dt
        self.limits = MonitorLimits()
        times = dict.fromkeys(("low_for", "high_for", "burst", "armed_for"), 0.0)
        self.rows = [SimpleNamespace(closed=0, collision=0, **times) for _ in range(contacts)]

    @property
    def calm(self) -> bool:
        """Whether all contacts hold, nothing is armed and no force is low."""
        return all(row.closed and not (row.armed_for or row.low_for) for row in self.rows)

    def update(self, alpha: Array, speed: Array) -> Array:
        """(2, r) whether each contact is made, and whether it was a blow, at one tick.

        Args:
            alpha: (r,) measured magnitudes (N), from the wrist filter. speed: (r,) NᵀV_rel (m/s).
        """
        x = self.limits
        for row, force, rate in zip(self.rows, alpha.tolist(), speed.tolist(), strict=True):
            _monitor(x, row, force, rate, self.dt, x.dwell, 0.0)
        flags = np.array([[row.closed, row.collision] for row in self.rows], dtype=bool)
        return flags.reshape(-1, 2).T


def watch_series(monitor: ContactMonitor, alpha: Array, speed: Array) -> tuple[Array, Array]:
    """Evaluate a monitor for k ticks: closed and collision, (k, r) each.

    While all contacts hold, no window is open and no force is low, the state of the monitor is
    constant; such ticks are skipped.

    Args:
        monitor: the monitor, whose state is updated. alpha: (k, r) forces (N).
        speed: (k, r) NᵀV_rel (m/s).
    """
    closed = np.ones(alpha.shape, dtype=bool)
    collision = np.zeros(alpha.shape, dtype=bool)
    low = np.flatnonzero((alpha < monitor.limits.force_off).any(axis=1))
    low = np.append(low, len(alpha))
    k = 0
    while k < len(alpha):
        closed[k], collision[k] = monitor.update(alpha[k], speed[k])
        k += 1
        if monitor.calm:
            k = int(low[np.searchsorted(low, k)])
    return closed, collision

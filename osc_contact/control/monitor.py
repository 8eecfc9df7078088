"""Contact monitor: contacts and collisions from projected force and power (figs. 6, 7).

While a contact holds, the power of the projected force is zero: α_k (NᵀV_rel)_k = 0. A collision
is a peak of this power as contact is made; contact is lost when the force disappears. Force is
judged with hysteresis; power only shortly before and after contact is made, so that noisy
velocities (of faces followed by vision) cause no false collisions during a contact.
"""

from types import SimpleNamespace

import numpy as np

from osc_contact.law import phases
from osc_contact.law.jit import as_python
from osc_contact.settings.control import MonitorLimits
from osc_contact.spatial import Array

_monitor = as_python(phases.monitor)  # the law's function as plain Python


class ContactMonitor:
    """Monitor of several contact forces, tick by tick, each by `law.phases.monitor`.

    Attributes:
        dt: control period (s).
        limits: thresholds.
        rows: state of each force: closed, collision (flags); low_for, high_for: time since the
            force fell below or rose above its threshold (s); burst: largest power since then (W);
            armed_for: remaining time in which a collision may be reported (s).
    """

    def __init__(self, contacts: int, dt: float) -> None:
        """Begin with all contacts open.

        Args:
            contacts: number of contact forces.
            dt: control period (s).
        """
        self.dt = dt
        self.limits = MonitorLimits()
        times = dict.fromkeys(("low_for", "high_for", "burst", "armed_for"), 0.0)
        self.rows = [SimpleNamespace(closed=0, collision=0, **times) for _ in range(contacts)]

    @property
    def calm(self) -> bool:
        """True if the state is constant: all contacts hold, no force is low, no timer runs."""
        return all(row.closed and not (row.armed_for or row.low_for) for row in self.rows)

    def update(self, alpha: Array, speed: Array) -> Array:
        """Judge the contacts in one tick.

        Args:
            alpha: (r,) measured contact forces (N), from the wrist filter.
            speed: (r,) NᵀV_rel (m/s).

        Returns:
            Two rows of flags (2, r): contact is made; it was made with a collision.
        """
        limits = self.limits
        for row, force, rate in zip(self.rows, alpha.tolist(), speed.tolist(), strict=True):
            _monitor(limits, row, force, rate, self.dt, limits.dwell, 0.0)
        flags = np.array([[row.closed, row.collision] for row in self.rows], dtype=bool)
        return flags.reshape(-1, 2).T


def watch_series(monitor: ContactMonitor, alpha: Array, speed: Array) -> tuple[Array, Array]:
    """Evaluate a monitor for a recording of k ticks.

    While the monitor is calm, its state is constant until a force is low; such ticks are skipped.

    Args:
        monitor: the monitor, whose state is updated.
        alpha: (k, r) forces (N).
        speed: (k, r) NᵀV_rel (m/s).

    Returns:
        Flags (k, r) each: contact is made; it was made with a collision.
    """
    is_closed = np.ones(alpha.shape, dtype=bool)
    collision = np.zeros(alpha.shape, dtype=bool)
    low_ticks = np.flatnonzero((alpha < monitor.limits.force_off).any(axis=1))
    low_ticks = np.append(low_ticks, len(alpha))
    k = 0
    while k < len(alpha):
        is_closed[k], collision[k] = monitor.update(alpha[k], speed[k])
        k += 1
        if monitor.calm:  # to the next tick with a low force, or to the end
            k = int(low_ticks[np.searchsorted(low_ticks, k)])
    return is_closed, collision

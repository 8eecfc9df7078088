"""Laws that know no contacts, with which plans of pegs are run for comparison.

Impedance of three stiffnesses, a fiftieth of it (N m/rad) in angles, damping ratio 1; `admittance`:
a position controller of 10 Hz whose set point is displaced by measured forces, with the packaged
mass, damping and stiffness (1000 N/m, 20 N m/rad); `position`: our motion law of 6 Hz.

Each force of a stage is reached by a motion that yields: the reference moves on until the measured
force is that of our stage. It moves at the speed with which our contacts are approached, so every
one of these laws has a guarded approach. Where our stage presses no longer, the reference first
moves to where the object is (`release`).
"""

from collections.abc import Callable

import numpy as np

import osc_contact as osc
from osc_contact.plan.ends import finished
from osc_contact.plan.motions import to

SPEED = osc.PhaseSettings().speed  #: of the approach (m/s)
MADE = 0.5  #: share of a force from which on it counts as reached


def _soft(stiffness: float) -> Callable[[], osc.Laws]:
    """Impedance of a stiffness (N/m)."""
    return lambda: osc.impedance((stiffness, stiffness / 50.0), damping_ratio=1.0)


#: Functions that make the laws of a controller, by name.
LAWS: dict[str, Callable[[], osc.Laws]] = {
    "impedance, 300 N/m": _soft(300.0),
    "impedance, 600 N/m": _soft(600.0),
    "impedance, 1500 N/m": _soft(1500.0),
    "admittance": lambda: osc.admittance(stiffness=(1000.0, 20.0)),
    "position": osc.Laws,
}


def controlled_by(laws: osc.Laws, ours: osc.Controller) -> osc.Controller:
    """Controller with a law that knows no contacts, in place of ours.

    Its check for encoders that stand still is off: joints that are blocked by a body that the law
    has no contact with are no stuck encoders.

    Args:
        laws: law without contacts.
        ours: controller with our law, without contacts.
    """
    safety = ours.settings.safety.replaced(stuck_speed=np.inf)
    return ours.with_safety(safety).with_laws(structure=laws.structure)


def release() -> osc.Stage:
    """Stage that takes back what pressed: the reference moves to the pose of the object."""
    motion = to(lambda now: now.X, 30e-3, 0.5)
    return osc.Stage("release", {}, motion, until=finished(), within=2.0, fails="back")

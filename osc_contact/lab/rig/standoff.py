"""Duration of the approach from the standoff of a tare, by the speed limits of the joints."""

from __future__ import annotations

import numpy as np

from osc_contact.lab.scenarios.schema import Scenario
from osc_contact.spatial import Array

#: Largest speed of the quintic from rest to rest that an approach follows, over its mean speed.
_PEAK = 1.875
#: Share of its speed limit that a joint may need: the rest is for the correction of errors.
_SHARE = 0.5


def within_speed_limits(scenario: Scenario, displacement: Array, limits: Array) -> Scenario:
    """Lengthen the approach after a tare so that no joint needs more than half of its speed limit.

    A duration that the scenario gives is kept. With contact phases contacts are approached at their
    own speed, but a motion is checked before a run by references with this approach.

    Args:
        scenario: scenario, with or without a tare.
        displacement: (n,) motion of the joints in the approach (rad, m).
        limits: (n,) their speed limits (rad/s, m/s); 0 or infinite: none.

    Returns:
        The scenario, or a copy with a longer approach.
    """
    tare = scenario.tare
    if tare is None or "approach" in tare.model_fields_set:
        return scenario
    limited = np.isfinite(limits) & (limits > 0.0)
    speeds = _PEAK * np.abs(displacement[limited])
    needed = float(np.max(speeds / (_SHARE * limits[limited]), initial=0.0))
    if needed <= tare.approach:
        return scenario
    return scenario.replaced(tare=tare.replaced(approach=needed))

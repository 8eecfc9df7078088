"""The whole control tick, fig. 4: measurement in, motor torques out, one call.

The stages are those of `control.controller.Controller`, which is the readable twin: the same
torques by other arithmetic. What cannot be decided here without doubt (ranks near their limits,
data that are not finite) is answered with ASK, and nothing of the state is changed.
"""

from __future__ import annotations

from typing import Any

from osc_contact.kernels import layout as at
from osc_contact.kernels.compile import entry, integers
from osc_contact.kernels.inputs import choose, commit, fit, keep
from osc_contact.kernels.model import model_stage
from osc_contact.kernels.stages import (
    contact_stage,
    force_stage,
    motion_stage,
    structure_stage,
    torque_stage,
)

__all__ = ["build"]


def build(stamp: int) -> Any:
    """The tick, to be compiled at its first call; `stamp` tells the cache of changed sources."""

    @entry
    def tick(bound, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, moving):
        """One control period; the torques and what `layout` names are left in the bound arrays.

        Args:
            bound: (COUNT, 4) addresses and shapes, see `layout`. Pinocchio's `crba` (WORLD) has
                run.
            q, v, wrenches: as in `interface.Measurement`.
            X_WD: (4, 4), V_D, A_D, alpha_d, squeeze: as in `interface.Reference`.
            moving: whether the touched bodies move. Which contacts count: `layout.TERMS`.

        Returns:
            OK, SATURATED or ASK, plus 4 r.
        """
        if stamp < 0:
            return at.ASK
        sizes = integers(bound, at.SIZES)[0]
        count = choose(bound, sizes)
        if not fit(
            bound, sizes, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, count > 0, moving
        ):  # fmt: skip
            return at.ASK
        m = model_stage(bound, sizes, v)
        if m < 0:
            return at.ASK
        r = contact_stage(bound, sizes, count, moving)
        if r < 0 or not force_stage(bound, sizes, r, count, wrenches, alpha_d):
            return at.ASK
        if not motion_stage(bound, sizes, r, m, X_WD, V_D, A_D):
            return at.ASK
        if not structure_stage(bound, sizes, r, m, squeeze):
            return at.ASK
        code = torque_stage(bound, sizes, r, m, q, v, squeeze)
        if code != at.ASK:
            keep(bound, sizes, q, v, wrenches, X_WD, V_D, A_D, alpha_d, squeeze, moving)
        if code == at.OK:
            commit(bound, r)
        return code + 4 * r

    return tick

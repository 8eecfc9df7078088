"""Arms that hold one object: the closed chain of section 6 and its equation of motion, eq. 13.

The object can make only the motions S that every arm permits (dual SCARA: five). In them

    Λ_S η̇ + μ_S + p_S + Sᵀf_c = G τ,        a = S η̇ + σ,        q̈ = W η̇ + w,

and Φ₀ = S Λ_S⁻¹ Sᵀ takes the place of Λ₀⁻¹: a 6×6 matrix of rank d, never a damped inverse.
Grasps may permit motions of their own (`Grasp`); these have no mass and no motor drives them.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from osc_contact.dynamics.chain_look import Look, read_state
from osc_contact.dynamics.chain_model import ChainModel
from osc_contact.dynamics.chain_rows import chain_row
from osc_contact.dynamics.chain_state import ChainState
from osc_contact.dynamics.front_end import require_pinocchio_agrees
from osc_contact.law.layout import Bytes
from osc_contact.law.tables import CHAIN, CHAIN_BYTES
from osc_contact.spatial import Array, as_array, carry_twist

__all__ = ["ClosedChain", "ChainState"]


class ClosedChain(ChainModel):
    """Several arms that hold one object (or one arm whose tip is the object).

    Made, and described by attributes, as its `ChainModel`.
    """

    def state(
        self,
        q: npt.ArrayLike,
        v: npt.ArrayLike,
        X_WO: pin.SE3 | None = None,
        V_O: npt.ArrayLike | None = None,
        *,
        data: pin.Data | None = None,
    ) -> ChainState:
        """Everything the contact model needs to know of the chain at (q, v).

        Args:
            q: (n,) joint positions, arms in order, each in model order, passive joints included.
            v: (n,) joint velocities, consistent with the closed loop.
            X_WO, V_O: pose and twist (6,) of the object, where the joints do not tell them.
            data: to work in (threads need one each); default: the chain's own.

        Raises:
            InvalidInputError: wrong sizes or non-finite numbers.
            ModelError: the joints do not tell where the object is, or the motors cannot drive
                every motion the arms permit.
        """
        q = as_array("q", q, (self.nq,))
        v = as_array("v", v, (self.nq,))
        data = self.data if data is None else data
        pin.forwardKinematics(self.model, data, q, v)
        if X_WO is None and V_O is None and self.leader is not None:
            row = self.law_row(led=True)
            now, rest = Look(row, q, v), Look(row, q, np.zeros(self.nq))
        else:
            row = self.law_row(led=False)
            X_WO = self.object_pose(data) if X_WO is None else X_WO
            V_O = self._twist(X_WO, data) if V_O is None else as_array("V_O", V_O, (6,))
            now = Look(row, q, v, X_WO.homogeneous, V_O)
            rest = Look(row, q, np.zeros(self.nq), X_WO.homogeneous, np.zeros(6))
        now.require_done()
        return read_state(self, now, rest, data)

    def _twist(self, X_WO: pin.SE3, data: pin.Data) -> Array | None:
        """(6,) of the object as the leader's tip tells it; None: the law finds it."""
        if self.leader is None:
            return None
        joint = self.model.frames[self.tips[self.leader]].parentJoint
        V = data.oMi[joint].act(data.v[joint]).vector
        return carry_twist(V, np.zeros(3), X_WO.translation)

    def law_row(self, led: bool) -> Bytes:
        """The chain as the law's MODEL, see `chain_row`.

        Raises:
            ModelError: arms that the law does not know.
        """
        row = self._rows[led]
        row[:CHAIN_BYTES].view(CHAIN)[0]["gravity"] = self.model.gravity.linear  # may have changed
        return row

    @cached_property
    def _rows(self) -> dict[bool, Bytes]:
        rows = {led: chain_row(self, led) for led in (False, True)}
        require_pinocchio_agrees(self, rows[False])
        return rows

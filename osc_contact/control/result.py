"""What one tick found, as plain arrays: what recordings keep."""

from __future__ import annotations

from dataclasses import dataclass

from osc_contact.control.tick_records import TickRecords
from osc_contact.spatial import Array

__all__ = ["TickResult", "internal_forces"]


def internal_forces(arms: int) -> int:
    """How many internal forces recordings keep: one for each two grasps, at least one."""
    return max(1, arms * (arms - 1) // 2)


@dataclass(frozen=True, eq=False)
class TickResult:
    """Views of a controller's records: the next tick overwrites them. At O in world axes.

    Attributes:
        records: where all of it stands.
        J: (n, 6) the joints' columns at the world's origin, one in each row.
        f_meas, bias_out: (6,) wrist readings less tare; what they would be without contact.
        f_c: (6,) contact force in them. V_O: (6,) twist of the object. X_WO: (4, 4) its pose.
        error: (6,) pose error. free_error: (6,) Ω_m(Λ_o⁻¹) of it.
        squeeze: (1,) internal force along the grasp line (N), > 0 compresses; with k ≥ 3 arms
            (k(k − 1)/2,) that between each two grasps, as in `Reference.squeeze_d`, or zeros
            where none is commanded.
        magnitudes, speeds: (6,) contact magnitudes measured and NᵀV_rel of the independent
            columns; the first r of them count.
    """

    records: TickRecords
    J: Array
    f_meas: Array
    bias_out: Array
    f_c: Array
    V_O: Array
    X_WO: Array
    error: Array
    free_error: Array
    squeeze: Array
    magnitudes: Array
    speeds: Array

    @classmethod
    def of(cls, records: TickRecords) -> TickResult:
        """The views of these records."""
        names = ("f_meas", "bias_out", "f_c", "V_O", "X_WO", "error", "free_error", "internal",
                 "alpha_meas", "speed")  # fmt: skip
        fields = [records.field(name) for name in names]
        if len(records.bars) > 1:
            fields[7] = records.bars
        return cls(records, records.jacobian, *fields)

    @property
    def rank(self) -> int:
        """r, independent columns of N in force."""
        return int(self.records.rank[0])

    @property
    def alpha_meas(self) -> Array:
        """(r,) contact magnitudes measured."""
        return self.magnitudes[: self.rank]

    @property
    def normal_speed(self) -> Array:
        """(r,) NᵀV_rel (m/s): 0 while the contacts last."""
        return self.speeds[: self.rank]

    @property
    def mobility(self) -> Array:
        """(r, r) D: normal acceleration for each newton on what is outboard of the sensors."""
        r = self.rank
        return self.records.work.mobility[:r, :r]

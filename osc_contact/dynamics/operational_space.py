"""Operational-space dynamics of a single arm at its tip: Λ, μ, p, J, J̄, Φ, h in world axes."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import numpy.typing as npt

from osc_contact.dynamics.arm import Arm
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError, ModelError
from osc_contact.law.chain import BAD_INERTIA
from osc_contact.law.compiled import operational_space as compiled
from osc_contact.law.reasons import SENTENCES
from osc_contact.law.records import Bytes, Rows
from osc_contact.spatial import Array, as_array


class OperationalSpace:
    """Equation of motion of an arm at its tip T, in world axes (eq. 13 of a single arm).

        F = Λ A + μ + p,    A = J v̇ + J̇ v = d/dt (J v),    τ = Jᵀ F,    τ = M v̇ + h

    J is Pinocchio's Jacobian of the tip, `LOCAL_WORLD_ALIGNED`; A, J̇ v and μ are classical. μ of
    `ArmTerms` belongs to the spatial acceleration A − [ω × v_T; 0] and is larger by
    Λ [ω × v_T; 0].

    If `rank` is 6, Λ = Φ⁻¹. An arm with fewer joints, or in a singular posture, moves its tip in
    range(J) only, of dimension `rank` (see `ClosedChain.rank_tolerance`); its structure carries the
    wrenches C, CᵀJ = 0. Then

    * Φ = J M⁻¹ Jᵀ exists, with that rank, and P = J J̄ = Φ Λ projects on the motions;
    * F of an acceleration A of the arm is unique up to the wrenches C, which need no torques, so
      that JᵀF is unique. SᵀΛS and J̄ S of any motions S in range(J) are unique, too;
    * Λ is not unique, and is defined as Λ = R S (SᵀR Φ R S)⁻¹ SᵀR with any basis S of the motions
      and the inertia R of a ball of 1 kg with a radius of gyration of 0.1 m at the tip. It is
      independent of frames and units. There is no damping.

    For several states the attributes have an additional first axis, the rows of q.

    Example:
        >>> from osc_contact import robots
        >>> urdf = robots.find_robot("panda")[0]
        >>> arm = osc.Arm.from_urdf(
        ...     urdf, name="panda", tip="panda_hand_tcp", wrist_sensor="panda_link7"
        ... )
        >>> terms = osc.operational_space(arm, q=[0, 0.1, 0, -2.2, 0, 2.3, 0.8], v=np.zeros(7))
        >>> print(terms.Lambda.shape, terms.J_bar.shape)
        (6, 6) (7, 6)
    """

    Lambda: Array  #: (6, 6) Λ, inertia at the tip (kg, kg m, kg m²)
    Phi: Array  #: (6, 6) Φ = J M⁻¹ Jᵀ
    J: Array  #: (6, n) Jacobian
    J_bar: Array  #: (n, 6) dynamically consistent inverse J̄ = M⁻¹ Jᵀ Λ
    mu: Array  #: (6,) μ = J̄ᵀ C v − Λ J̇ v (N, N m)
    p: Array  #: (6,) p = J̄ᵀ g (N, N m)
    drift: Array  #: (6,) J̇ v (m/s², rad/s²)
    h: Array  #: (n,) C v + g, without friction (N m, N)
    rank: Array  #: () motions of the tip

    def __init__(self, arm: Arm, *rows: int) -> None:
        """Allocate the results.

        Args:
            arm: the arm.
            rows: number of states, or nothing for a single state without a first axis.
        """
        self._arm = _compiled_arm(arm)  #: compiled terms of the arm
        self._rows = rows  #: (number of states,), or () for a single state
        #: (number of states, size) results, of which the terms are views
        self._numbers = np.empty((rows[0] if rows else 1, self._arm.size))

    def __getattr__(self, name: str) -> Array:
        """Return a view of a term, such as `Lambda`, in the row or rows of results."""
        if name.startswith("_") or name not in (self._arm.dtype.names or ()):
            raise AttributeError(f"'{type(self).__name__}' has no attribute '{name}'")
        table = self._numbers.view(self._arm.dtype).reshape(self._rows)
        return np.asarray(table[name])


class _CompiledArm:
    """Records of the law for one arm, with a copy for each thread that computes at the same time.

    Attributes:
        n: number of joints.
        dtype: layout of the terms of one state.
        size: number of doubles of the terms of one state.
        raw: records of the arm, which are copied for each thread.
        free: copies that no thread uses.
    """

    def __init__(self, arm: Arm) -> None:
        """Lay out the terms of a state, and pack the arm into records.

        `dtype` is the layout of the terms of one state, `size` their count of numbers, `raw` the
        records with the arm's model, `free` copies of `raw` that no thread uses at the moment.

        Raises:
            ModelError: an arm that the law does not support.
        """
        n = arm.model.nv
        shapes = {
            "Lambda": (6, 6),
            "Phi": (6, 6),
            "J": (6, n),
            "J_bar": (n, 6),
            "mu": 6,
            "p": 6,
            "drift": 6,
            "h": n,
            "rank": (),
        }
        self.n = n
        self.dtype = np.dtype([(name, float, shape) for name, shape in shapes.items()])
        self.size = self.dtype.itemsize // 8
        self.raw: Bytes = Rows(ClosedChain([arm]).law_row(from_leader=False)).raw
        self.free: list[Bytes] = []


def _compiled_arm(arm: Arm) -> _CompiledArm:
    """Return the records of an arm, which are made at the first use and stored in the arm."""
    compiled_arm: _CompiledArm | None = vars(arm).get("_compiled")
    if compiled_arm is None:
        compiled_arm = _CompiledArm(arm)
        vars(arm)["_compiled"] = compiled_arm  # `Arm` is frozen for users only
    return compiled_arm


def operational_space(
    arm: Arm, q: npt.ArrayLike, v: npt.ArrayLike, out: OperationalSpace | None = None
) -> OperationalSpace:
    """Compute Λ, μ, p, J, J̄, Φ and h of an arm at its tip in world axes, see `OperationalSpace`.

    The function is compiled and takes about as long as `pin.computeAllTerms`. Any number of threads
    may call it.

    Args:
        arm: the arm, without a held object; its rotor inertia is part of M.
        q, v: (n,), or (rows, n) for many states at once (rad, m; rad/s, m/s).
        out: a former result for this arm and number of rows, to be overwritten. With it, and
            contiguous arrays (n,) of float64, nothing is allocated.

    Raises:
        InvalidInputError: wrong sizes, a NaN/inf, or `out` of another arm or number of rows.
        ModelError: an arm that the law does not support, or whose inertia is not positive definite.

    Source: O. Khatib, A unified approach for motion and force control of robot manipulators: the
    operational space formulation, IEEE J. Robotics and Automation 3(1), 1987.
    """
    if out is None:
        shape = np.shape(q)
        out = OperationalSpace(arm, shape[0]) if len(shape) > 1 else OperationalSpace(arm)
    compiled_arm = out._arm
    if compiled_arm is not _compiled_arm(arm):
        raise InvalidInputError(f"out is a result of another arm than {arm.name!r}")
    numbers = out._numbers
    try:
        raw = compiled_arm.free.pop()
    except IndexError:  # other threads use all copies
        raw = compiled_arm.raw.copy()
    call = compiled()
    computed = -1  # number of states with results
    if not out._rows:
        with suppress(TypeError, AttributeError):  # raised for inputs other than float64 vectors
            computed = call(raw, q, v, numbers)
    if computed < len(numbers):
        expected = (*out._rows, compiled_arm.n)
        q = as_array("q", q, expected).reshape(-1)
        v = as_array("v", v, expected).reshape(-1)
        computed = call(raw, q, v, numbers)
        if computed < len(numbers):
            raise ModelError(SENTENCES[BAD_INERTIA])
    compiled_arm.free.append(raw)
    return out

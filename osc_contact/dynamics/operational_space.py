"""Operational-space dynamics of one arm at its tip, alone: Λ, μ, p, J, J̄, Φ, h in world axes."""

from __future__ import annotations

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

    J is Pinocchio's of the tip, `LOCAL_WORLD_ALIGNED`, and A, J̇ v and μ are classical as J is:
    μ of `ArmTerms` goes with the spatial acceleration A − [ω × v_T; 0] and is larger by
    Λ [ω × v_T; 0].

    With `rank` 6, Λ = Φ⁻¹. An arm with fewer joints, or in a singular posture, moves its tip in
    range(J) only, `rank` motions (counted as by `ClosedChain.rank_tolerance`); its structure
    carries the wrenches C, CᵀJ = 0. Then

    * Φ = J M⁻¹ Jᵀ exists, of that rank, and P = J J̄ = Φ Λ projects on the motions;
    * F is unique for A that the arm can make, up to the wrenches C, which no motor feels: JᵀF is
      unique. So are SᵀΛS and J̄ S of any motions S in range(J);
    * Λ by itself needs a choice: it resists as Λ = R S (SᵀR Φ R S)⁻¹ SᵀR does, S any basis of the
      motions, R the inertia of a ball of 1 kg with a radius of gyration of 0.1 m at the tip. It is
      the same in every frame and every unit. Nothing is damped.

    Attributes have the rows of q in front, if there are several.

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
        """Memory for the terms of an arm.

        Args:
            arm: whose. rows: of q; none: q is a single one, (n,).

        Raises:
            ModelError: an arm that the law cannot take.
        """
        self._arm = _compiled_arm(arm)
        self._rows = rows
        self._numbers = np.empty(((*rows, 1)[0], self._arm.size))

    def __getattr__(self, name: str) -> Array:
        if name.startswith("_") or name not in (self._arm.dtype.names or ()):
            raise AttributeError(f"'{type(self).__name__}' has no attribute '{name}'")
        table = self._numbers.view(self._arm.dtype).reshape(self._rows)
        return np.asarray(table[name])


class _CompiledArm:
    """An arm as the law takes it, and memory to work in: as many as threads work at once."""

    def __init__(self, arm: Arm) -> None:
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
        self.raw: Bytes = Rows(ClosedChain([arm]).law_row(led=False)).raw
        self.free: list[Bytes] = []


def _compiled_arm(arm: Arm) -> _CompiledArm:
    """Made at the first use, kept with the arm."""
    found: _CompiledArm | None = vars(arm).get("_compiled")
    if found is None:
        vars(arm)["_compiled"] = found = _CompiledArm(arm)
    return found


def operational_space(
    arm: Arm, q: npt.ArrayLike, v: npt.ArrayLike, out: OperationalSpace | None = None
) -> OperationalSpace:
    """Λ, μ, p, J, J̄, Φ and h of an arm at its tip in world axes, see `OperationalSpace`.

    Compiled: it costs about what `pin.computeAllTerms` does. Any number of threads may call it.

    Args:
        arm: its base, tip and joints as loaded (rotor inertia is in M); nothing is held.
        q, v: (n,), or (rows, n) for many states at once (rad, m; rad/s, m/s).
        out: a former result of this arm and as many rows, to be overwritten. With (n,) contiguous
            arrays of float64 nothing is allocated then.

    Raises:
        InvalidInputError: wrong sizes, a NaN/inf, or `out` of another arm or number of rows.
        ModelError: an arm that the law cannot take, or whose inertia is not positive definite.

    Source: O. Khatib, A unified approach for motion and force control of robot manipulators: the
    operational space formulation, IEEE J. Robotics and Automation 3(1), 1987.
    """
    if out is None:
        out = OperationalSpace(arm, *np.shape(q)[:-1][:1])
    own = out._arm
    if own is not _compiled_arm(arm):
        raise InvalidInputError(f"out is a result of another arm than {arm.name!r}")
    numbers = out._numbers
    try:
        raw = own.free.pop()
    except IndexError:  # all of it is in use by other threads
        raw = own.raw.copy()
    call = compiled()
    try:
        done = -1 if out._rows else call(raw, q, v, numbers)
    except (TypeError, AttributeError):  # no plain vectors of float64
        done = -1
    if done < len(numbers):
        shape = (*out._rows, own.n)
        q, v = (as_array(name, x, shape).reshape(-1) for name, x in (("q", q), ("v", v)))
        done = call(raw, q, v, numbers)
        if done < len(numbers):
            raise ModelError(SENTENCES[BAD_INERTIA])
    own.free.append(raw)
    return out

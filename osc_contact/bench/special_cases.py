"""Rigs in trouble or with more switched on than usual, and many rigs at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.bench.cases import (
    TickCase,
    in_motion,
    one_panda,
    rod_rig,
    two_contact_rod,
)
from osc_contact.bench.random_arms import faces_of, random_rig
from osc_contact.contacts.pairs import VertexOnFace
from osc_contact.control.batch import BatchController
from osc_contact.control.controller import Status
from osc_contact.control.phases import PhaseSettings
from osc_contact.dynamics.assembly import close, object_pose, reach
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import InvalidInputError
from osc_contact.interface import Reference
from osc_contact.spatial import Array

__all__ = ["BATCHES", "ROWS", "SPECIAL_CASES", "BatchCase", "OwnFace"]

ROWS = 4096
NEAR_STRAIGHT = 0.217  #: m further out than the packaged pose: elbows at 0.13 rad
TOO_MUCH = 1.25  #: of the limit of one motor is wanted


class OwnFace(VertexOnFace):
    """A pair written by a user: its N and n_γ come from Python in every tick."""

    def contact(self, *args, **kwargs):  # type: ignore[no-untyped-def]
        """Those of a vertex on a face."""
        return super().contact(*args, **kwargs)


def near_singular() -> TickCase:
    """The rod rig with both elbows 0.13 rad from straight: motion commands are reduced."""
    rig, gains, pairs = rod_rig()
    shift = np.array([0.0, NEAR_STRAIGHT, 0.0])
    X = object_pose(rig.chain, rig.q_contact)
    q = close(rig.chain, reach(rig.chain, rig.q_contact, _shifted(X, shift)))
    moved = tuple(replace(pair, point=pair.point + shift) for pair in pairs)

    def reference(t: float) -> Reference:
        at = rig.references.at(t)
        return replace(at, X_WD=_shifted(at.X_WD, shift))

    return in_motion("near_singular", rig.chain, moved, q, gains, reference, Status.DEGRADED)


def _shifted(X: pin.SE3, shift: Array) -> pin.SE3:
    return pin.SE3(X.rotation, X.translation + shift)


def saturated() -> TickCase:
    """The rod rig with motors too weak for what is commanded: a quadratic program in each tick."""
    case = two_contact_rod()
    tau = case.controller().tick(case.measurement, case.reference)
    chain = ClosedChain(case.chain.arms, case.chain.grasps, case.chain.payload)
    used = float(np.max(np.abs(tau) / case.chain.tau_max))
    chain.tau_max = case.chain.tau_max * (used / TOO_MUCH)
    return replace(case, name="saturated", chain=chain, status=Status.SATURATED)


def three_arms() -> TickCase:
    """Three arms like a UR5, a force commanded between each two grasps, two contacts."""
    rng = np.random.default_rng(0)
    rig = random_rig(["ur5"] * 3, rng)
    pairs = tuple(pair for pair in faces_of(rig, 2, 2, rng) if isinstance(pair, VertexOnFace))
    controller, measurement, reference = rig.controller(list(pairs))
    wanted = replace(reference, squeeze_d=np.array([10.0, 5.0, 8.0]))
    return TickCase("three_arms", rig.chain, pairs, controller.gains, rig.q, measurement, wanted)


def contact_phases() -> TickCase:
    """The rod rig, its two contacts opened and closed one by one; here both are closed."""
    return replace(two_contact_rod(), name="contact_phases", life=PhaseSettings())


def own_pair() -> TickCase:
    """The rod rig, one of its two contacts a pair written in Python."""
    case = two_contact_rod()
    first, second = case.pairs
    own = OwnFace(first.vertex, first.point, first.normal, first.radius, name=first.name)
    return replace(case, name="own_pair", pairs=(own, second))


def _in_other_arrays(name: str, make: Callable[[Array], Any]) -> TickCase:
    """The rod rig, its measurement and reference in arrays of another kind."""
    case = two_contact_rod()
    m, r = case.measurement, case.reference
    return replace(
        case,
        name=name,
        measurement=replace(m, q=make(m.q), v=make(m.v), wrenches=make(m.wrenches)),
        reference=replace(r, V_D=make(r.V_D), A_D=make(r.A_D), alpha_d=make(r.alpha_d)),
    )


def single_precision() -> TickCase:
    """The rod rig, every array of single precision."""
    return _in_other_arrays("single_precision", lambda x: x.astype(np.float32))


def strided() -> TickCase:
    """The rod rig, every array a view of every second element."""
    return _in_other_arrays("strided", lambda x: np.repeat(x, 2, axis=-1)[..., ::2])


def lists() -> TickCase:
    """The rod rig, lists in the place of arrays."""
    return _in_other_arrays("lists", lambda x: x.tolist())


SPECIAL_CASES: dict[str, Callable[[], TickCase]] = {
    "near_singular": near_singular,
    "saturated": saturated,
    "three_arms": three_arms,
    "contact_phases": contact_phases,
    "own_pair": own_pair,
    "single_precision": single_precision,
    "strided": strided,
    "lists": lists,
}


@dataclass(frozen=True)
class BatchCase:
    """Rows of one rig, each at a state of its own.

    Attributes:
        case: the rig. rows, threads: of the batch.
        q, v: (rows, n). wrenches: (rows, arms, 6). X_WD: (rows, 4, 4). V_D, A_D: (rows, 6).
        alpha_d: (rows, r). squeeze_d: (rows,).
    """

    case: TickCase
    rows: int
    threads: int
    q: Array
    v: Array
    wrenches: Array
    X_WD: Array
    V_D: Array
    A_D: Array
    alpha_d: Array
    squeeze_d: Array

    @classmethod
    def around(cls, case: TickCase, rows: int, threads: int) -> BatchCase:
        """Rows at random states close to the case's.

        Args:
            case: of the single tick. rows: how many. threads: of the batch.
        """
        rng = np.random.default_rng(0)
        m, r = case.measurement, case.reference

        def near(x: Array, spread: float) -> Array:
            x = np.asarray(x, dtype=float)
            return np.asarray(x + spread * rng.normal(size=(rows, *x.shape)))

        return cls(
            case, rows, threads, near(m.q, 1e-3), near(m.v, 1e-3), near(m.wrenches, 0.1),
            np.tile(r.X_WD.homogeneous, (rows, 1, 1)), near(r.V_D, 1e-3), near(r.A_D, 0.0),
            near(r.alpha_d, 0.1), np.full(rows, float(r.squeeze_d)),
        )  # fmt: skip

    def batch(self) -> BatchController:
        """The controllers of all rows."""
        return BatchController([self.case.controller()] * self.rows, self.threads)

    def tick(self) -> tuple[Callable[[], Array], Callable[[], None]]:
        """A tick of all rows, and what is to be called after each, as in `TickCase.tick`."""
        batch, expected = self.batch(), self.case.status

        def tick() -> Array:
            return batch.tick(
                self.q, self.v, self.wrenches, self.X_WD, self.V_D, self.A_D, self.alpha_d,
                self.squeeze_d,
            )  # fmt: skip

        def unwind() -> None:
            wrong = np.flatnonzero(batch.status != expected)
            if len(wrong):
                ended = Status(int(batch.status[wrong[0]])).name
                raise InvalidInputError(
                    f"{self.case.name}: a timed tick ended {ended} in {len(wrong)} rows, the first "
                    f"of them {wrong[0]}, expected {expected.name}"
                )
            batch.reset()

        return tick, unwind

    def floor(self) -> Callable[[], object]:
        """`pin.computeAllTerms` of all rows, one after the other."""
        model, data = self.case.chain.model, self.case.chain.model.createData()

        def floor() -> None:
            for q, v in zip(self.q, self.v, strict=True):
                pin.computeAllTerms(model, data, q, v)

        return floor


def _batch(case: Callable[[], TickCase], threads: int) -> Callable[[], BatchCase]:
    return lambda: BatchCase.around(case(), ROWS, threads)


BATCHES: dict[str, Callable[[], BatchCase]] = {
    "batch_4096": _batch(one_panda, 1),
    "batch_4096_two_threads": _batch(one_panda, 2),
    "batch_4096_rods": _batch(two_contact_rod, 1),
    "batch_4096_rods_two_threads": _batch(two_contact_rod, 2),
}

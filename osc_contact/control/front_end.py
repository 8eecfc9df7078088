"""The law's own kinematics and dynamics of the arms, judged by Pinocchio at construction."""

from __future__ import annotations

from typing import Any
from weakref import WeakSet

import numpy as np
import pinocchio as pin

from osc_contact.control.tick_records import TickRecords, rows
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import ModelError
from osc_contact.law import tick as law
from osc_contact.law.tables import OBJECT_UNKNOWN
from osc_contact.spatial import Array

__all__ = ["require_pinocchio_agrees"]

STATES, TOLERANCE = 3, 1e-9

_judged: WeakSet[ClosedChain] = WeakSet()


def require_pinocchio_agrees(chain: ClosedChain, records: TickRecords) -> None:
    """Compare J, M and h = C v + g on a few random states, once for each chain.

    Args:
        chain: the arms. records: of a controller that has not ticked yet; MEMORY is not changed.

    Raises:
        ModelError: a difference above 1e-9 of the largest element: a kind of joint or a property of
            the model that the law does not know.
    """
    if chain in _judged:
        return
    rng, data, n = np.random.default_rng(0), chain.model.createData(), chain.nq
    memory = records.memory_bytes.copy()
    row = records.row.copy()
    row.head.rubs = 0  # Pinocchio's h has no friction
    trial = TickRecords(row, memory)
    trial.memory.engaged, trial.memory.located = 0, 1
    trial.memory.X_WO[:] = np.eye(4)
    for _ in range(STATES):
        q, v = rng.uniform(-1.0, 1.0, n), rng.normal(size=n)
        _look(chain, trial, q, v)
        pin.computeAllTerms(chain.model, data, q, v)
        if trial.work.reason == OBJECT_UNKNOWN:  # no object fits random joints: no further
            found = {"placements": (trial.joints.p, [X.translation for X in list(data.oMi)[1:]])}
        else:
            M = np.zeros((n, n))
            for s in chain.slices:
                M[s, s] = trial.joints.M[s, : s.stop - s.start]
            found = {
                "J": (trial.jacobian, data.J.T),
                "M": (M, data.M),
                "h": (trial.joints.h, data.nle),
            }
        for name, (ours, theirs) in found.items():
            _require_equal(name, np.asarray(ours), np.asarray(theirs))
    _judged.add(chain)


def _look(chain: ClosedChain, trial: TickRecords, q: Array, v: Array) -> None:
    """The first part of a tick, with everything else zero."""
    k, head, six = len(chain.arms), trial.row.head, np.zeros(6)
    rows()(
        trial.row.raw, trial.memory_bytes, trial.work_bytes, q, v, np.zeros((k, 6)), np.eye(4), six,
        six, np.zeros(int(head.n_columns)), np.zeros(max(1, int(head.n_bars))),
        np.zeros((int(head.n_contacts), 28)), 0, np.zeros(chain.n_a), np.zeros(1, dtype=np.int64),
        law.LOOK, law.MEASURE, 0, 1,
    )  # fmt: skip


def _require_equal(name: str, ours: Any, theirs: Any) -> None:
    worst = float(np.abs(ours - theirs).max(initial=0.0))
    if not worst <= TOLERANCE * max(1.0, float(np.abs(theirs).max(initial=0.0))):
        raise ModelError(
            f"the control law's {name} differs from Pinocchio's by {worst:.3g} on a random state: "
            "the model has a joint or a property that the law does not know. Please report it with "
            "the model; a chain of plain revolute and prismatic joints is known"
        )

"""What of a tick is the arms' own recursion: placements, J, drift, joint forces, M.

The law's parts that stand for a model evaluation are compiled by themselves and run many times in
one call, beside Pinocchio's `computeAllTerms` of the same arms.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rich.table import Table

from benchmarks.cases import CASES
from benchmarks.measuring import bars, machine, new_axes, take_turns
from osc_contact.law.arm_motion import move_arm, place_arm
from osc_contact.law.jit import entry
from osc_contact.law.tables import (
    read_arm_work,
    read_arms,
    read_chain,
    read_joint_work,
    read_joints,
)
from osc_contact.law.tables import read_work as read_head

__all__ = ["draw", "measure", "tables"]

REPEATS = 100  #: in one call, so that the call itself does not count


@entry
def _evaluate(model, raw, q, v, times):
    chain, work = read_chain(model, 0, 1)[0], read_head(raw, 0, 1)[0]
    arms = read_arms(model, chain.arms_at, chain.n_arms)
    table = read_joints(model, chain.joints_at, chain.n_joints)
    own = read_arm_work(raw, chain.arm_work_at, chain.n_arms)
    joints = read_joint_work(raw, chain.joint_work_at, chain.n_joints)
    for _ in range(times):
        for k in range(chain.n_arms):
            place_arm(table, joints, arms[k].first, arms[k].end, q)
            move_arm(
                arms[k], table, joints, v, work.C, chain.gravity, work.s, work.t, own[k].V,
                own[k].drift, own[k].bias,
            )  # fmt: skip


def measure(rounds: int = 2000) -> dict[str, Any]:
    """{"machine", "cases": {name: {"arms", "joints", "us_per_arm", "floor_us_per_arm"}}}, medians.

    Args:
        rounds: timed calls of each case.

    Raises:
        InvalidInputError: no rounds.
    """
    cases: dict[str, Any] = {}
    for name, make in CASES.items():
        case = make()
        controller, m, arms = case.controller(), case.measurement, len(case.chain.arms)
        controller.tick(m, case.reference)
        records, model = controller._records, case.chain.model
        data, raw, work = model.createData(), records.row.raw, records.work_bytes
        _evaluate(raw, work, m.q, m.v, 1)
        if not np.allclose(records.joints.M[0, 0], pin.crba(model, data, m.q)[0, 0]):
            raise AssertionError(f"{name}: M is not Pinocchio's")  # the timed work is the right one
        times = take_turns(
            {
                "law": lambda r=raw, w=work, m=m: _evaluate(r, w, m.q, m.v, REPEATS),
                "floor": lambda o=model, d=data, m=m: pin.computeAllTerms(o, d, m.q, m.v),
            },
            rounds,
        )
        cases[name] = {
            "arms": arms,
            "joints": model.nq // arms,
            "us_per_arm": float(np.median(times["law"])) / (REPEATS * arms),
            "floor_us_per_arm": float(np.median(times["floor"])) / arms,
        }
    return {"machine": machine(), "cases": cases}


def tables(result: dict[str, Any]) -> list[Table]:
    """One row of each case."""
    table = Table("case", "arms", "joints of an arm", "front end (µs an arm)", "computeAllTerms")
    for name, row in result["cases"].items():
        table.add_row(
            name, str(row["arms"]), str(row["joints"]), f"{row['us_per_arm']:.2f}",
            f"{row['floor_us_per_arm']:.2f}",
        )  # fmt: skip
    return [table]


def draw(result: dict[str, Any], path: Path) -> None:
    """Both times of each case as bars."""
    from osc_contact.visual.plots import save, style

    with style():
        figure, (ax,) = new_axes(1)
        bars(ax, {name: row["us_per_arm"] for name, row in result["cases"].items()}, "µs an arm")
        save(figure, path.with_suffix(""))

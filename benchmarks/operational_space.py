"""Λ, μ, p, J, J̄, Φ, h of one arm beside `computeAllTerms`, and beside the same with Pinocchio."""

from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin

import osc_contact as osc
from benchmarks.cases import PANDA_Q, panda
from benchmarks.measuring import Call, Rows, spread, take_turns
from osc_contact import robots

ROWS = 1000
FLOOR = "pin.computeAllTerms"


def measure(rounds: int) -> dict[str, Rows]:
    """{"operational_space": rows} of each arm and call, in turns.

    Args:
        rounds: timed calls of each.
    """
    ur5 = osc.Arm.from_urdf(robots.find_robot("ur5")[0], name="UR5", tip="tool0")
    arms = (
        (panda("Panda", pin.SE3.Identity()), PANDA_Q),
        (ur5, np.array([0.0, -1.2, 1.4, -1.0, -1.5, 0.3])),
    )
    return {"operational_space": [row for arm, q in arms for row in _time(arm, q, rounds)]}


def _time(arm: osc.Arm, q: Any, rounds: int) -> Rows:
    model = arm.model
    data = model.createData()
    v = np.full(model.nv, 0.3)
    kept = osc.operational_space(arm, q, v)
    many = (np.tile(q, (ROWS, 1)), np.tile(v, (ROWS, 1)))
    batch = osc.operational_space(arm, *many)
    calls: dict[str, Call] = {
        FLOOR: partial(pin.computeAllTerms, model, data, q, v),
        "operational_space(…, out=…)": lambda: osc.operational_space(arm, q, v, out=kept),
        "operational_space(…)": partial(osc.operational_space, arm, q, v),
    }
    times = take_turns(calls, rounds)
    by_hand = partial(_by_hand, model, data, arm.tip, q, v)
    times |= take_turns({"with Pinocchio and NumPy": by_hand}, rounds)  # alone in the caches
    rows = take_turns({"": partial(osc.operational_space, arm, *many, batch)}, rounds // 20 + 1)
    times[f"a row of {ROWS}"] = rows[""] / ROWS
    floor = np.median(times[FLOOR])
    return [
        {"arm": arm.name, "call (µs)": call, **spread(some), "ratio": np.median(some) / floor}
        for call, some in times.items()
    ]


def _by_hand(model: pin.Model, data: pin.Data, tip: str, q: Any, v: Any) -> object:
    pin.computeAllTerms(model, data, q, v)
    pin.computeJointJacobiansTimeVariation(model, data, q, v)
    pin.computeGeneralizedGravity(model, data, q)
    pin.updateFramePlacements(model, data)
    at = (model, data, model.getFrameId(tip), pin.LOCAL_WORLD_ALIGNED)
    J = pin.getFrameJacobian(*at)
    rate = pin.getFrameJacobianTimeVariation(*at)
    bar = np.linalg.solve(data.M, J.T)
    Phi = J @ bar
    Lambda = np.linalg.inv(Phi)
    J_bar = bar @ Lambda
    return (J_bar, J_bar.T @ data.g, J_bar.T @ (data.nle - data.g) - Lambda @ (rate @ v))

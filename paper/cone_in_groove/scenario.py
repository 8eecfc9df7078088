"""Fig. 2 as a scenario made in Python: the pair is an object, no file could name it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from osc_contact.scenarios.schema import Scenario
from paper.cone_in_groove.geometry import Seat

__all__ = ["STEP_TIMES", "cone_scenario"]

PERIOD = 1e-3  #: s
STEP_TIMES = (2.0, 2.7, 3.4, 4.1)  #: s at which the pushes on the walls step, one after the other
_REST = (9.0, 7.0, 8.0, 10.0)  # N, pushes on the walls
_STEPS = (4.0, -3.0, 5.0, -4.0)  # N
_TURN = {"type": "sine", "amplitude": 0.6, "frequency": 0.4, "ramp": 1.0}  # rad
_SLIDE = {"type": "sine", "amplitude": 0.04, "frequency": 0.55, "ramp": 1.0}  # m


def cone_scenario(
    seat: Seat,
    duration: float = 5.0,
    step_times: tuple[float, ...] = STEP_TIMES,
    moving: bool = True,
) -> Scenario:
    """A Panda turns and slides the cone at once while its pushes on the walls step.

    Args:
        seat: where the cone lies.
        duration: s.
        step_times: of the wall forces, one after the other (s); at most four.
        moving: whether the cone turns and slides.
    """
    groove, start = seat.groove, seat.X_start
    apex = start.act(seat.cone.apex)
    walls = seat.from_wall_forces  # α = R λ: every wall force is part of every magnitude
    steps = list(zip(walls.T, _STEPS, step_times, strict=False))
    force = {
        f"cone.{i + 1}": [
            {"type": "minimum_jerk", "value": float(walls[i] @ _REST), "duration": 0.3},
            *({"type": "step", "value": float(column[i] * value), "start": at}
              for column, value, at in steps),
        ]
        for i in range(4)
    }  # fmt: skip
    motion = [
        {"kind": "linear", "direction": groove.direction, "signals": [_SLIDE]},
        {"kind": "angular", "direction": seat.axis, "through": apex, "signals": [_TURN]},
    ]
    data = {
        "name": "cone_in_groove",
        "arms": [{
            "name": "panda", "urdf": "example-robot-data:panda", "tip": "panda_hand_tcp",
            "wrist_sensor": "panda_hand", "posture": [0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78],
        }],
        "object": {"urdf": "cone.urdf", "pose": _pose(start)},
        "grasps": {"panda": {}},
        "environment": [{
            "name": "groove", "urdf": "groove.urdf",
            "pose": {"xyz": groove.point, "rpy": [0, 0, groove.yaw]},
        }],
        "contacts": [{"pair": seat.pair, "body": "groove"}],
        "force": force,
        "motion": motion if moving else [],
        "gains": {"motion": {"stiffness": 400, "damping": 40}, "force": {"integral": 20}},
        "control": {"rate": 1.0 / PERIOD},
        "plant": {"type": "rigid", "step": PERIOD},
        "duration": duration,
    }  # fmt: skip
    return Scenario.from_dict(data, Path(__file__))


def _pose(X: pin.SE3) -> dict[str, object]:
    return {"xyz": X.translation, "rpy": np.asarray(pin.rpy.matrixToRpy(X.rotation))}

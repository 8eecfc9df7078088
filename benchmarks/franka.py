"""From a Franka's state to its torques: over libfranka's protocol, beside a simulated robot."""

from __future__ import annotations

import os
import sys
import tempfile
from itertools import repeat
from pathlib import Path

import numpy as np
from rich.table import Table

import osc_contact as osc
from benchmarks.measuring import machine, require_count
from osc_contact.drivers.franka import FrankaRobot
from paper.study import Data, table_of

SHARES = ("p50", "p99", "p99_9", "max")


def measure(ticks: int = 60_000) -> Data:
    """{"machine": …, "loops": {"plain" | "realtime": report}}, with how each loop ended.

    The robot is the server of the tests, in a separate process, at 1 kHz, on the last processor
    alone, as a robot's controller is a computer by itself; the loop has the others. The arm holds
    its posture, and every tick is recorded.

    Args:
        ticks: of each loop.

    Raises:
        InvalidInputError: no ticks.
    """
    require_count(ticks, "ticks")
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from franka_rig import FrankaServer

    loops = {}
    with tempfile.TemporaryDirectory() as folder:
        *ours, last = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {last})
        server = FrankaServer(Path(folder))  # inherits it
        os.sched_setaffinity(0, ours or {last})
        try:
            for name in ("plain", "realtime"):
                server.begin(height=0.0, clock=True)
                chain = osc.ClosedChain([server.arm()])
                robot = FrankaRobot(server.host, chain)
                q = robot.measure().q
                controller = osc.Controller(chain, [], dt=1e-3, posture=q)
                X = chain.state(q, np.zeros(7)).X_WO
                hold = repeat(osc.pose_reference(X.translation, X.rotation), ticks)
                recorder = osc.Recorder(controller)
                loop = {"recorder": recorder, "realtime": name == "realtime"}
                found = {"ended": "complete"}
                try:
                    found |= osc.run_loop(robot, controller, hold, **loop).as_dict()
                except osc.PlantError as error:  # as on a machine that does other things, too
                    found |= recorder.recording().meta.get("loop", {}) | {"ended": str(error)}
                loops[name] = found | {"least_success_rate": robot.least_success_rate}
                robot.close()
        finally:
            server.end()
            os.sched_setaffinity(0, {*ours, last})
    return {"machine": machine(), "loops": loops}


def tables(result: Data) -> list[Table]:
    """Read-to-write times of both loops, and what the system did not permit."""
    rows = [
        (
            name,
            loop.get("ticks", "–"),
            *(f"{loop.get('read_to_write_us', {}).get(share, np.nan):.0f}" for share in SHARES),
            loop.get("missed", "–"),
            f"{loop['least_success_rate']:.2f}",
            loop["ended"],
        )
        for name, loop in result["loops"].items()
    ]
    notes = result["loops"]["realtime"].get("notes", [])
    title = "; ".join(["from a state to its torques, µs", *notes])
    columns = f"loop; ticks; {'; '.join(SHARES)}; missed; success rate; end"
    return [table_of(title, columns, rows)]

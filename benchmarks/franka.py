"""From a Franka's state to its torques: over libfranka's protocol, beside a simulated robot."""

from __future__ import annotations

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
    """{"machine": …, "loops": {"plain" | "realtime": report}}.

    The robot is the server of the tests, in a separate process, at 1 kHz; the arm holds its
    posture, and every tick is recorded.

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
        server = FrankaServer(Path(folder))
        try:
            for name in ("plain", "realtime"):
                server.begin(height=0.0, clock=True)
                chain = osc.ClosedChain([server.arm()])
                robot = FrankaRobot(server.host, chain)
                q = robot.measure().q
                controller = osc.Controller(chain, [], dt=1e-3, posture=q)
                X = chain.state(q, np.zeros(7)).X_WO
                hold = repeat(osc.pose_reference(X.translation, X.rotation), ticks)
                loop = {"recorder": osc.Recorder(controller), "realtime": name == "realtime"}
                report = osc.run_loop(robot, controller, hold, **loop)
                rates = {"least_success_rate": robot.least_success_rate}
                loops[name] = report.as_dict() | rates
                robot.close()
        finally:
            server.end()
    return {"machine": machine(), "loops": loops}


def tables(result: Data) -> list[Table]:
    """Read-to-write times of both loops, and what the system did not permit."""
    rows = [
        (
            name,
            loop["ticks"],
            *(f"{loop['read_to_write_us'][share]:.0f}" for share in SHARES),
            loop["missed"],
            f"{loop['least_success_rate']:.2f}",
        )
        for name, loop in result["loops"].items()
    ]
    title = "from a state to its torques, µs; " + ("; ".join(result["loops"]["realtime"]["notes"]))
    return [table_of(title, f"loop; ticks; {'; '.join(SHARES)}; missed; success rate", rows)]

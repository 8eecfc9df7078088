"""From a Franka's state to its torques: over libfranka's protocol, beside a simulated robot."""

import os
import sys
import tempfile
from functools import partial
from importlib import import_module
from itertools import repeat
from pathlib import Path

import osc_contact as osc
from benchmarks.measuring import SHARES
from osc_contact.drivers.franka import FrankaRobot
from paper.study import Data


def measure(ticks: int) -> Data:
    """{"loops": rows}: times (µs) from a state to its torques, and how each loop ended.

    The robot is the server of the tests, in a separate process, at 1 kHz, on the last processor
    alone, as a robot's controller is a computer by itself; the loop has the others. The arm holds
    its posture, and every tick is recorded.

    Args:
        ticks: number of ticks of each loop.
    """
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    FrankaServer = import_module("franka_rig").FrankaServer

    rows = []
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
                X = chain.state(q).X_WO
                hold = repeat(osc.pose_reference(X.translation, X.rotation), ticks)
                recorder = osc.Recorder(controller)
                loop = partial(osc.run_loop, recorder=recorder, realtime=name == "realtime")
                found: Data = {"ended": "complete"}
                try:
                    found |= loop(robot, controller, hold).as_dict()
                except osc.PlantError as error:  # as on a machine that does other things, too
                    found |= recorder.recording().meta.get("loop", {}) | {"ended": str(error)}
                rows.append(
                    {
                        "loop": name,
                        "ticks": found.get("ticks"),
                        **found.get("read_to_write_us", dict.fromkeys(SHARES)),
                        "missed": found.get("missed"),
                        "success rate": robot.least_success_rate,
                        "notes": ", ".join(found.get("notes", [])),
                        "end": found["ended"],
                    }
                )
                robot.close()
        finally:
            server.end()
            os.sched_setaffinity(0, {*ours, last})
    return {"loops": rows}

"""Time TSID on a Panda: run by the interpreter of TSID's own environment, prints JSON.

    python -I tsid_peer.py panda.urdf ROUNDS

Task: pose of the tool (6 rows), posture (7 rows) and one point contact of the tool with friction
cone (3 motion rows, 3 forces), fingers locked. Timed apart: `computeProblemData` (model and tasks),
`solve` (eiquadprog) with `getActuatorForces`, and both together; beside them the floor of that
environment's Pinocchio.
"""

import glob
import json
import sys
from time import perf_counter_ns
from typing import Any

for _folder in glob.glob(
    f"{sys.prefix}/lib/python*/site-packages/cmeel.prefix/lib/python*/site-packages/tsid"
):
    sys.path.insert(0, _folder)

import numpy as np  # noqa: E402
import pinocchio as pin  # noqa: E402
import tsid_pywrap as tsid  # noqa: E402

WARM_UP = 5
TOOL = "panda_hand_tcp"
Q = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.78])


def main(urdf: str, rounds: int) -> None:
    """Measure and print."""
    full = pin.buildModelFromUrdf(urdf)
    fingers = [j for j in range(1, full.njoints) if "finger" in full.names[j]]
    model = pin.buildReducedModel(full, fingers, pin.neutral(full))
    robot = tsid.RobotWrapper(model, tsid.FIXED_BASE_SYSTEM, False)
    v = np.full(7, 0.1)
    law = tsid.InverseDynamicsFormulationAccForce("law", robot, False)
    law.computeProblemData(0.0, Q, v)
    pose = robot.framePosition(law.data(), model.getFrameId(TOOL))

    contact = tsid.ContactPoint("contact", robot, TOOL, np.array([0.0, 0.0, 1.0]), 0.3, 1.0, 100.0)
    _set(contact, np.full(3, 100.0), 20.0, pose)
    law.addRigidContact(contact, 1e-5)

    tool = tsid.TaskSE3Equality("tool", robot, TOOL)
    still = tsid.TrajectorySE3Constant("tool", pose).computeNext()
    _set(tool, np.full(6, 900.0), 60.0, still)
    law.addMotionTask(tool, 1.0, 1, 0.0)

    posture = tsid.TaskJointPosture("posture", robot)
    rest = tsid.TrajectoryEuclidianConstant("posture", Q).computeNext()
    _set(posture, np.full(7, 25.0), 10.0, rest)
    law.addMotionTask(posture, 1e-3, 1, 0.0)

    solver = tsid.SolverHQuadProgFast("solver")
    solver.resize(law.nVar, law.nEq, law.nIn)
    data = model.createData()
    times = np.zeros((rounds + WARM_UP, 3))
    for row in times:
        start = perf_counter_ns()
        problem = law.computeProblemData(0.0, Q, v)
        middle = perf_counter_ns()
        solution = solver.solve(problem)
        tau = law.getActuatorForces(solution)
        end = perf_counter_ns()
        pin.computeAllTerms(model, data, Q, v)
        row[:] = (middle - start, end - middle, perf_counter_ns() - end)
        if solution.status != 0 or not np.isfinite(tau).all():
            raise SystemExit(f"TSID found no solution: status {solution.status}")
    setup, solve, floor = times[WARM_UP:].T / 1e3
    found = {
        "TSID: pose, posture, one contact": setup + solve,
        "computeProblemData": setup,
        "solve": solve,
        f"computeAllTerms of pin {pin.__version__}": floor,
    }
    print(json.dumps({part: times.tolist() for part, times in found.items()}))


def _set(task: Any, stiffness: Any, damping: float, reference: Any) -> None:
    task.setKp(stiffness)
    task.setKd(damping + 0.0 * stiffness)
    task.setReference(reference)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))

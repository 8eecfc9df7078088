"""Motions that a grasp leaves to an arm alone: somebody must hold them, in every posture."""

import numpy as np
import pytest
from grasp_rigs import random_case
from numpy.random import default_rng
from numpy.testing import assert_allclose
from test_grasps import NOTHING, forces

import osc_contact as osc
from osc_contact.control.controller import Controller
from osc_contact.scenarios.control_schema import PostureTask

RIGS = {
    "SCARA on a slide": (["scara", "ur5"], ["slide", "rigid"], 0, [1, 12, 14]),
    "four joints in a plane": (["4R"], ["rigid"], 0, [5, 6, 7]),
    "UR5 on a ball beside four joints in a plane": (["ur5", "4R"], ["ball", "rigid"], 1, [8, 9]),
}


def cases():
    for name, (arms, kinds, which, seeds) in RIGS.items():
        for seed in seeds:
            yield pytest.param(arms, kinds, which, seed, id=f"{name}-{seed}")


@pytest.mark.parametrize("arms, kinds, which, seed", list(cases()))
def test_idle_motions_obey_the_posture_task(arms, kinds, which, seed):
    """Accelerations by the full system of equations; gravity acts on idle joints too."""
    rng = default_rng(seed)
    case = random_case(arms, kinds, rng)
    chain = osc.ClosedChain(case.chain.arms, case.chain.grasps, case.chain.payload)
    v, V = (0.1 * x for x in case.moving(rng))
    rest = case.q + 0.05 * rng.standard_normal(chain.nq)
    controller = Controller(chain, [], posture=rest)
    reference = osc.Reference(case.X_WO, V)
    tau = controller.tick(osc.Measurement(case.q, v, np.zeros((len(arms), 6))), reference)
    assert controller.status in (osc.Status.OK, osc.Status.DEGRADED), controller.reason
    found = case.system(v, V).solve(forces(case, tau), NOTHING.N, np.zeros(0))
    assert found.residual < 1e-9
    s = chain.slices[which]
    arm = chain.state(case.q, v).arms[which]
    idle = np.linalg.svd(arm.N.T @ arm.J)[2][arm.rank :]
    assert len(idle) == arm.J.shape[1] - arm.rank > 0
    task = PostureTask()
    want = task.stiffness * (rest - case.q)[s] - task.retreat_damping * v[s]
    assert_allclose(idle @ arm.M @ found.qdd[s], idle @ arm.M @ want, atol=1e-7)


def test_an_arm_whose_idle_motion_no_motor_drives_still_moves_the_object():
    """A passive joint that swings by itself: nothing holds it, and nothing is held up by it."""
    rng = default_rng(3)
    case = random_case(["4R"], ["rigid"], rng)
    arm = case.chain.arms[0]
    loose = osc.Arm(arm.name, arm.model, arm.tip, arm.base, ("joint1",), arm.wrist_sensor)
    chain = osc.ClosedChain([loose], case.chain.grasps, case.chain.payload)
    reference = osc.Reference(case.X_WO, np.zeros(6), np.array([0.1, -0.2, 0.3, 0.1, 0.2, -0.1]))
    controller = Controller(chain, [], posture=case.q)
    still = np.zeros(4)
    tau = controller.tick(osc.Measurement(case.q, still, np.zeros((1, 6))), reference)
    assert controller.status is osc.Status.OK, controller.reason
    force = np.insert(tau, 1, 0.0)
    found = case.system(still, np.zeros(6)).solve(force, NOTHING.N, np.zeros(0))
    s = controller.signals
    assert_allclose(found.a_object, s.state.S @ s.eta_c + s.state.sigma, atol=1e-8)

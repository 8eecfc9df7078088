"""Fig. 5: contact forces out of wrist readings, exact and without accelerometers."""

import numpy as np
import pinocchio as pin
from grasp_rigs import random_case
from kkt_oracle import pressed
from numpy.random import default_rng
from rigs import UNLIMITED, miss
from samples import parametrize
from test_grasps import touching

import osc_contact as osc


@parametrize("arm", ["panda", "ur5", "2R", "3R", "4R"])
def test_forces_at_a_tip_that_holds_nothing(arm):
    """What moves beyond the sensor is taken out, whatever the motions that the tip has."""
    rng = default_rng(27)
    seen = 0
    for _ in range(12):
        case = random_case([arm], ["rigid"], rng, body=None)
        pairs = touching(case, rng)
        state = pressed(case, pairs)
        state.move(rng)
        truth = state.answer(20.0 * rng.standard_normal(case.chain.n_a))
        controller = osc.Controller(case.chain, pairs, safety=UNLIMITED)
        reference = osc.Reference(pin.SE3.Identity(), alpha_d=np.zeros(len(pairs)))
        read = osc.Measurement(case.q, state.v, state.readings(truth))
        controller.tick(read, reference)
        assert controller.status is not osc.Status.HELD, controller.reason
        assert miss(controller.result().alpha_meas, truth.alpha) < 1e-7
        seen += len(pairs)
    assert seen > 8

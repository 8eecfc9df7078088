"""Fig. 5: contact forces out of wrist readings, exact and without accelerometers."""

import numpy as np
import pinocchio as pin
from grasp_rigs import random_case
from kkt_oracle import held, pressed
from numpy.random import default_rng
from numpy.testing import assert_allclose
from rigs import (
    PANDA_Q,
    ROD,
    UNLIMITED,
    consistent,
    contact_of,
    largest,
    panda_arm,
    placed,
    random_faces,
    refused,
    scara_pair,
)
from samples import parametrize
from test_grasps import touching

import osc_contact as osc


def found_by_law(chain, pairs, q, v, wrenches, f_tare=0.0):
    """What the law finds in these readings."""
    controller = osc.Controller(chain, pairs, safety=UNLIMITED)
    controller.f_tare = np.zeros(6) + f_tare
    wanted = osc.Reference(pin.SE3.Identity(), alpha_d=np.zeros(len(pairs)))
    controller.tick(osc.Measurement(q, v, wrenches), wanted)
    assert controller.status is not osc.Status.HELD, controller.reason
    return controller.result()


def test_the_law_weighs_what_is_outboard_of_the_frame_it_is_given():
    """Readings of the hand's sensor, carried to a frame before the hand and to one beyond it."""
    flange, hand, tool = (
        osc.ClosedChain(
            [panda_arm(wrist_sensor=sensor, damping=0.0)], [placed(z=0.05)], osc.RigidObject(ROD)
        )
        for sensor in ("panda_link8", "panda_hand", "panda_hand_tcp")
    )
    rng = default_rng(25)
    errors = []
    for _ in range(20):
        q, v, pairs = pressing(hand, rng)
        whole = held(hand, q, v, pairs)
        truth = whole.answer(rng.standard_normal(7) * 20)
        wrenches = whole.readings(truth)
        alpha = truth.alpha
        X_WS = hand.state(q, v).sensors[0]
        miss = []
        for chain in (flange, tool):
            X = chain.state(q, v).sensors[0].inverse() * X_WS
            carried = X.act(pin.Force(wrenches[0])).vector[None]
            miss.append(largest(found_by_law(chain, pairs, q, v, carried).alpha_meas - alpha))
        assert miss[0] < 1e-9 * max(largest(alpha), 1.0)  # link 8 has no mass of its own
        errors.append(miss[1])
    assert min(errors) > 0.1


@parametrize("bad", [{"integral": -1.0}, {"damping": float("nan")}])
def test_bad_force_gains_are_refused(bad):
    with refused("ForceGains"):
        osc.ForceGains(**bad)


def test_an_integral_gain_without_stability_margin_is_refused():
    with refused("stability margin"):
        osc.Controller(scara_pair(), [], osc.Gains(force=osc.ForceGains(integral=1000.0)))


def pressing(chain, rng):
    """(q, v, pairs) of one Panda on two faces."""
    q = PANDA_Q + rng.uniform(-0.5, 0.5, 7)
    v = rng.standard_normal(7)
    free = chain.state(q, v)
    pairs = random_faces(free.X_WO, 2, rng)
    return q, consistent(chain, q, v, contact_of(pairs, free).N), pairs


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
        found = found_by_law(case.chain, pairs, case.q, state.v, state.readings(truth))
        assert_allclose(
            found.alpha_meas, truth.alpha, atol=1e-8 * np.abs(truth.alpha).max(initial=1.0)
        )
        seen += len(pairs)
    assert seen > 8

"""Batches: every row is its single tick, bit for bit, whatever its neighbours do."""

import copy
import pickle

import numpy as np
import pinocchio as pin
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from rigs import one_panda, posed, random_faces, refused, scara_pair, touched_of, with_motors
from samples import parametrize
from test_law import motion_of

import osc_contact as osc
from osc_contact.dynamics.environment import Conveyor


def controllers(chain, count, rng, **how):
    """Controllers of one structure with different gains, faces and postures."""
    out = []
    q, _, X = posed(chain, rng)
    for i in range(count):
        motion = osc.MotionGains(rng.uniform(200, 600), rng.uniform(20, 60), rng.uniform(0, 2000))
        k = rng.uniform(5, 40)
        gains = osc.Gains(
            motion, osc.ForceGains(bandwidth=k / 6) if i % 2 else osc.ForceGains(k, 5)
        )
        posture = q + 0.1 * rng.standard_normal(chain.nq)
        out.append(osc.Controller(chain, random_faces(X, 2, rng), gains, posture=posture, **how))
    return (out, q)


def story(chain, q, count, ticks, rng, moving=False):
    """Measurements and references (ticks, count, …)."""
    X = chain.state(q).X_WO.homogeneous
    faces = [motion_of(rng, 2) for _ in range(count * moving)]
    rows = [np.hstack((face.X_WE.reshape(2, 16), face.V_E, face.A_E)) for face in faces]
    moved = {"touched": np.array(rows)} if moving else {}
    return [
        moved
        | {
            "q": q + 1e-3 * rng.standard_normal((count, chain.nq)),
            "v": 1e-2 * rng.standard_normal((count, chain.nq)),
            "wrenches": 5.0 * rng.standard_normal((count, len(chain.arms), 6)),
            "X_WD": np.repeat(X[None], count, axis=0),
            "V_D": 0.02 * rng.standard_normal((count, 6)),
            "A_D": 0.1 * rng.standard_normal((count, 6)),
            "alpha_d": rng.uniform(2, 20, (count, 2)),
            "squeeze_d": rng.uniform(0, 3, count),
            "wrench_valid": rng.random(count) < 0.7,
        }
        for _ in range(ticks)
    ]


def single(controller, x, i):
    touched = touched_of(x["touched"][i]) if "touched" in x else None
    readings = (x["q"][i], x["v"][i], x["wrenches"][i], touched)
    measurement = osc.Measurement(*readings, wrench_valid=bool(x["wrench_valid"][i]))
    reference = osc.Reference(
        pin.SE3(x["X_WD"][i]), x["V_D"][i], x["A_D"][i], x["alpha_d"][i], float(x["squeeze_d"][i])
    )
    return controller.tick(measurement, reference)


@parametrize("threads", [1, 2])
@parametrize(
    "rig, motors, how",
    [
        (one_panda, 1.0, {}),
        (scara_pair, 1.0, {"bodies": [Conveyor()] * 2}),
        (scara_pair, 1.0, {"life": osc.PhaseSettings()}),
        (scara_pair, 0.1, {}),
    ],
)
def test_rows_are_single_ticks_bit_for_bit(rig, motors, how, threads):
    """Each judges its own readings; faces move; some are beyond the limits of weak motors."""
    chain = rig() if motors == 1.0 else with_motors(rig(), motors * rig().tau_max)
    rng = default_rng(3)
    count = 12
    ones, q = controllers(chain, count, rng, **how)
    batch = osc.BatchController(ones, threads)
    twelve = [copy.copy(c) for c in ones]
    seen = set()
    for x in story(chain, q, count, 8, rng, "bodies" in how):
        x["v"][3, 0] = (
            np.nan if rng.random() < 0.3 else x["v"][3, 0]
        )  # one row is held now and then
        tau = batch.tick(**x)
        for i, c in enumerate(twelve):
            assert_array_equal(tau[i], single(c, x, i))
            assert (batch.status[i], batch.state[i]) == (c.status, c.state)
            seen.add(int(c.status))
            assert_array_equal(batch.alpha_meas[i], c.records.memory.columns.alpha)
    assert {osc.Status.HELD, osc.Status.OK if motors == 1.0 else osc.Status.SATURATED} <= seen


def test_reset_by_mask_and_pickles():
    chain = scara_pair()
    rng = default_rng(5)
    ones, q = controllers(chain, 4, rng)
    batch = osc.BatchController(ones)
    first, *rest = story(chain, q, 4, 4, rng)
    began = batch.tick(**first)
    for x in rest:
        batch.tick(**x)
    assert_array_equal(pickle.loads(pickle.dumps(batch)).tick(**first), batch.tick(**first))
    batch.reset(np.array([True, False, True, False]))
    again = batch.tick(**first)
    assert_array_equal(again[[0, 2]], began[[0, 2]])
    assert (again[[1, 3]] != began[[1, 3]]).any()


def test_what_is_no_batch_is_refused():
    chain = scara_pair()
    rng = default_rng(7)
    ones, q = controllers(chain, 2, rng)
    with refused("≥ 1"):
        osc.BatchController([])
    fewer = osc.Controller(chain, ones[0].contacts[:1])
    with refused("n_columns"):
        osc.BatchController([ones[0], fewer])
    own = ones[0].with_laws(force=lambda a, b: a)
    with refused("only Python"):
        osc.BatchController([own])
    batch = osc.BatchController(ones)
    x = story(chain, q, 2, 1, rng)[0]
    with refused(r"q: expected shape \(2, 10\)"):
        batch.tick(**{**x, "q": x["q"][:1]})
    with refused("mask"):
        batch.reset([True])


def test_rows_that_share_a_model_part_when_one_is_replaced():
    chain = scara_pair()
    rng = default_rng(9)
    (one, other), q = controllers(chain, 2, rng)
    batch = osc.BatchController([one] * 3)
    x = story(chain, q, 3, 1, rng)[0]
    began = batch.tick(**x)
    batch.reset()
    batch.replace(1, other)
    again = batch.tick(**x)
    assert_array_equal(again[[0, 2]], began[[0, 2]])
    assert_array_equal(again[1], single(copy.copy(other), x, 1))
    assert (again[1] != began[1]).any()

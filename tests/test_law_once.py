"""The law against the NumPy law of `readable`, one tick of each kind: fast without compilation.

`test_law.py` goes on from here with many states of each. These judge small faults put into the law
(`tests/mutants.py`), so each test takes as little as it can and runs lines of its own.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from grasp_rigs import random_case
from pair_kinds import KINDS, touching
from rigs import one_panda, panda_pair, random_faces, random_state, scara_pair
from test_law import (
    Wall,
    accelerated_alike,
    agree,
    disturb,
    inputs,
    motion_of,
    off_their_faces,
    twins,
)

import osc_contact as osc
from osc_contact.control.friction import Friction
from osc_contact.dynamics.rail import Cart, Conveyor

BODIES = {
    "fixed": None, "conveyor": Conveyor(), "cart": Cart([1, 2, 3], 5.0, 100, 3, 2), "own": Wall(),
}  # fmt: skip
RIGS = {"scara_pair": scara_pair, "panda_pair": panda_pair, "one_panda": one_panda}


def metric(B, rng):
    A = rng.normal(size=(6, 6))
    return A @ A.T + np.eye(6) if B == "matrix" else B


@pytest.mark.parametrize(
    ("rig", "r", "B"),
    [("scara_pair", 0, "object"), ("scara_pair", 2, "chain"), ("scara_pair", 5, "matrix"),
     ("panda_pair", 1, "chain"), ("panda_pair", 3, "matrix"), ("panda_pair", 6, "object"),
     ("one_panda", 1, "matrix"), ("one_panda", 4, "object")],
)  # fmt: skip
def test_faces(rig, r, B):
    chain, rng = RIGS[rig](), np.random.default_rng(50 + r)
    status = osc.Status.HELD
    while status is osc.Status.HELD:  # the arms cannot push there
        q, v = random_state(chain, rng)
        pairs = random_faces(chain.state(q, v).X_WO, r, rng)
        how = {"B": metric(B, rng), "posture": q + 0.1 * rng.normal(size=chain.nq)}
        fast, slow = twins(chain, pairs, **how)
        disturb(rng, fast, slow)
        measurement, reference = inputs(chain, q, v, rng, r)
        slow.tick(measurement, reference)
        status = slow.status
    slow.motion_law.integral = fast.motion_law.integral.copy()
    slow.force_law.integral, slow.more_friction = np.zeros(0), 0.0
    for _ in range(2):
        agree(fast, slow, measurement, reference, 1e-10)
        accelerated_alike(fast, slow, 1e-10)


@pytest.mark.parametrize(
    ("arms", "kinds", "squeeze", "seed"),
    [(["ur5", "panda"], ["rigid", "hinge"], 5.0, 3), (["ur5", "panda"], ["ball", "rigid"], 5.0, 4),
     (["ur5", "ur5"], ["hinge", "hinge"], 5.0, 5), (["ur5", "panda"], ["slide", "slide"], 5.0, 0),
     (["scara", "ur5"], ["hinge", "rigid"], 5.0, 1),
     (["ur5", "panda", "ur5"], ["rigid", "hinge", "ball"], np.array([3.0, -2.0, 5.0]), 6),
     (["panda"] * 4, ["rigid"] * 4, 4.0, 7)],
)  # fmt: skip
def test_grasps(arms, kinds, squeeze, seed):
    rng, state = np.random.default_rng(seed), None
    while state is None or any(lost.chi < 0.1 for lost in state.singular_directions):
        case = random_case(arms, kinds, rng)
        chain = osc.ClosedChain(case.chain.arms, case.chain.grasps, case.chain.payload)
        try:
            state = chain.state(case.q, np.zeros(chain.nq))
        except osc.ModelError:  # the grasps do not fix the object
            continue
    fast, slow = twins(chain, random_faces(state.X_WO, 2, rng), posture=case.q)
    disturb(rng, fast, slow)
    measurement, reference = inputs(chain, case.q, 0.3 * rng.normal(size=chain.nq), rng, 2)
    agree(fast, slow, measurement, replace(reference, squeeze_d=squeeze), 1e-9)
    accelerated_alike(fast, slow, 1e-9)
    np.testing.assert_allclose(fast.result().squeeze, slow.result().squeeze, atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_pairs(kind):
    """On a body that moves; then on one that rests."""
    chain, rng = panda_pair(), np.random.default_rng(60)
    q, v = random_state(chain, rng)
    pairs = [touching(kind, chain.state(q, v).X_WO, 7, per_metre=0.1)]
    columns = len(pairs[0].gaps(pin.SE3.Identity()))
    fast, slow = twins(chain, pairs)
    disturb(rng, fast, slow)
    # gap functions are differentiated numerically, at poses that differ by rounding
    tolerance = 1e-9 if isinstance(pairs[0], osc.GapFunctions) else 1e-11
    for touched in (motion_of(rng, 1), None):
        agree(fast, slow, *inputs(chain, q, v, rng, columns, touched), tolerance)


@pytest.mark.parametrize("mu", [0.0, 0.4])
@pytest.mark.parametrize("body", [*BODIES, "many"])
def test_bodies(body, mu):
    """Vertices on faces of one body or of several, with friction and without."""
    chain, rng = scara_pair() if mu else panda_pair(), np.random.default_rng(61)
    q, v = random_state(chain, rng)
    pairs = off_their_faces(chain.state(q, v).X_WO, 3, rng)
    on = [BODIES.get(body)] * 3
    if body == "many":
        on = [BODIES["cart"], BODIES["own"], BODIES["cart"]]
    how = {"friction": Friction(mu, 0.01)} if mu else {}
    fast, slow = twins(chain, pairs, bodies=on, **how)
    disturb(rng, fast, slow)
    for touched in (motion_of(rng, 3), None):
        agree(fast, slow, *inputs(chain, q, v, rng, 3, touched), 1e-11)
        accelerated_alike(fast, slow, 1e-11)


def test_motors_that_are_too_weak():
    strong, rng, status = scara_pair(), np.random.default_rng(39), None
    chain = osc.ClosedChain(strong.arms, strong.grasps, strong.payload)
    chain.tau_max = 0.3 * strong.tau_max
    while status is not osc.Status.SATURATED:
        q, v = random_state(chain, rng)
        fast, slow = twins(chain, random_faces(chain.state(q, v).X_WO, 2, rng))
        agree(fast, slow, *inputs(chain, q, v, rng, 2))
        status = slow.status


@pytest.mark.parametrize("bend", [0.02, 0.15, 0.3])
def test_near_a_singular_posture(bend):
    """Elbows bent by so much: commands fade along what the arms can hardly move."""
    chain, rng, status = scara_pair(), np.random.default_rng(62), osc.Status.HELD
    q = np.zeros(chain.nq)
    q[0:2], q[5:7] = (0.5, bend), (np.pi - 0.5, -bend)
    X = chain.state(q, np.zeros(chain.nq)).X_WO
    fast, slow = twins(chain, random_faces(X, 1, rng))
    for _ in range(2):
        agree(fast, slow, *inputs(chain, q, 0.1 * rng.normal(size=chain.nq), rng, 1), 1e-8)
        status = fast.status
    assert status is not osc.Status.HELD


def test_dependent_columns():
    """A table on six legs, three of them independent."""
    chain, rng = panda_pair(), np.random.default_rng(34)
    q, v = random_state(chain, rng)
    X = chain.state(q, v).X_WO
    n = X.rotation @ np.array([0.0, 0.0, 1.0])
    spots = np.column_stack((rng.uniform(-0.2, 0.2, (6, 2)), np.full(6, -0.05)))
    pairs = [osc.VertexOnFace(p, X.act(p), n, name=f"leg{i}") for i, p in enumerate(spots)]
    fast, slow = twins(chain, pairs)
    agree(fast, slow, *inputs(chain, q, v, rng, 6))
    assert fast.result().rank == 3

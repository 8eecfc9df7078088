"""Ticks under any commands, for the tests; squeeze, and what has no answer."""

import numpy as np
import pinocchio as pin
import pytest
from grasp_oracle import kkt
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import raises
from rigs import (
    UNLIMITED,
    consistent,
    contact_of,
    largest,
    panda_pair,
    random_faces,
    random_state,
    refused,
    scara_pair,
    unit,
)

import osc_contact as osc
from osc_contact.control.custom_laws import Laws
from osc_contact.response import require_reachable


def in_contact(chain, rng, r=2):
    """A random state in contact: (state, contact, pairs, q, v)."""
    while True:
        q, v = random_state(chain, rng)
        free = chain.state(q, v)
        pairs = random_faces(free.X_WO, r, rng)
        try:
            require_reachable(free, contact_of(pairs, free))
        except osc.ContactError:
            continue
        v = consistent(chain, q, v, contact_of(pairs, free).N)
        state = chain.state(q, v)
        return state, contact_of(pairs, state), pairs, q, v


def strong(chain):
    """The same chain with motors in the same proportions that reach no limit."""
    parts = chain.arms, chain.grasps, chain.payload
    how = chain.rank_tolerance, chain.angle_tolerance
    out = osc.ClosedChain(*parts, rank_tolerance=how[0], angle_tolerance=how[1])
    out.tau_max = 1e4 * chain.tau_max
    return out


def tick_with(laws, chain, pairs, q, v, squeeze, *, touched=None, wrenches=None, weak=False, **how):
    """A controller after one tick under these laws; and its torques. Strong motors unless weak."""
    how.setdefault("safety", UNLIMITED)  # states out of any motion
    controller = osc.Controller(chain if weak else strong(chain), pairs, laws=laws, **how)
    wrenches = np.zeros((len(chain.arms), 6)) if wrenches is None else wrenches
    columns = sum(len(pair.gaps(pin.SE3.Identity())) for pair in pairs)
    wanted = osc.Reference(pin.SE3.Identity(), alpha_d=np.zeros(columns), squeeze_d=squeeze)
    tau = controller.tick(osc.Measurement(q, v, wrenches, touched), wanted)
    fine = osc.Status.OK, osc.Status.DEGRADED
    assert weak or controller.status in fine, controller.reason
    return controller, tau


def commanded(chain, pairs, q, v, a_u, alpha_u, B, squeeze=5.0, **how):
    """The tick of the law that commands a_u (6,), spatial, and alpha_u (r,)."""

    def motion(reference, X_WO, V_O):
        return a_u + np.concatenate((np.cross(V_O[3:], V_O[:3]), np.zeros(3)))  # classical

    laws = Laws(force=lambda desired, measured: alpha_u, motion=motion)
    how["joint_friction"] = False  # what the oracles answer is without
    return tick_with(laws, chain, pairs, q, v, squeeze, B=B, **how)


def structured(chain, q, v, f_S, eta, squeeze, posture=None, state=None, **how):
    """Torques of the law's allocation for any f_S (d,) and η̇ (d,), in the basis S of a state."""

    def structure(signals):
        if state is None:
            return eta, f_S
        S = state.S
        metric = state.metric
        wrench = metric @ S @ np.linalg.solve(S.T @ metric @ S, f_S)
        other = signals.state.S
        return np.linalg.lstsq(other, S @ eta, rcond=None)[0], other.T @ wrench

    laws = Laws(structure=structure)
    return tick_with(laws, chain, [], q, v, squeeze, posture=posture, **how)[1]


def test_a_contact_on_the_locked_couple_is_refused():
    chain = scara_pair()
    q, v = random_state(chain, default_rng(15))
    state = chain.state(q, v)
    with raises(osc.ContactError, match="column 1"):
        osc.contact_response(
            state, osc.Contact(np.column_stack((np.eye(6)[:, 2], state.C[:, 0]))), tau=np.zeros(8)
        )


def test_contact_response_wants_exactly_one_command():
    chain = scara_pair()
    state = chain.state(*random_state(chain, default_rng(16)))
    nothing = osc.Contact(np.zeros((6, 0)))
    with refused("exactly one"):
        osc.contact_response(state, nothing)
    with refused("exactly one"):
        osc.contact_response(state, nothing, tau=np.zeros(8), f_S=np.zeros(5))


@pytest.mark.parametrize("rig", [scara_pair, panda_pair])
def test_squeeze_arises_between_the_grasps_and_disturbs_nothing(rig):
    """Judged by the wrenches of the KKT oracle: ½ eᵀ(λ₁ − λ₂) along the grasp line."""
    chain = rig()
    rng = default_rng(30)
    for _ in range(10):
        state, contact, pairs, q, v = in_contact(chain, rng)
        line = state.grasp_points[1] - state.grasp_points[0]
        e = unit(line)
        a_u = rng.standard_normal(6)
        alpha = rng.uniform(5, 20, 2)
        B = np.linalg.inv(state.metric)
        seen = []
        for squeeze in (-15.0, 25.0):
            _, tau = commanded(chain, pairs, q, v, a_u, alpha, B, squeeze)
            got = kkt(chain, q, v, tau, contact.N, contact.n_gamma)
            force = got.loops[:, :3]
            assert 0.5 * e @ (force[0] - force[1]) == pytest.approx(squeeze, abs=1e-6)
            seen.append(got)
        scale = largest(seen[0].a_object)
        assert_allclose(seen[0].a_object, seen[1].a_object, atol=1e-9 * scale)
        assert_allclose(seen[0].alpha, seen[1].alpha, atol=1e-7)


def test_a_redundant_arm_with_passive_joints_is_refused():
    arm = panda_pair().arms[0]
    limp = osc.Arm(arm.name, arm.model, arm.tip, arm.base, passive_joints=("panda_joint7",))
    chain = osc.ClosedChain([limp], None, panda_pair().payload)
    with pytest.raises(osc.ModelError, match="posture"):
        osc.Controller(chain, [])

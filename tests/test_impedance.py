"""Impedance and admittance: their equations, by what the rigid plant does under them."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from complaints import invalid_input, refusals
from numpy.linalg import solve
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pytest import fixture
from rigs import largest, rig_of, ticked
from samples import parametrize

import osc_contact as osc
from osc_contact.spatial import classical_to_spatial, pose_error

SETS = ["plant.type=rigid", "plant.step=1 ms"]
KEYS = np.array([900.0, 700.0, 500.0, 40.0, 30.0, 20.0])


@fixture(scope="module", params=["two_contact_rod", "panda_edge"])
def rig(request):
    made = rig_of(request.param, *SETS)
    # viscous friction is compensated along the permitted command, not along the speed read here
    made.chain.model.damping = np.zeros(made.chain.nq)
    return made


def moving(rig, seed):
    """A plant in motion on its contacts, and a reference beside it."""
    rng = default_rng(seed)
    plant = rig.plant()
    controller = rig.controller()
    osc.run_loop(plant, controller, rig.references.over(0.3 + 1e-3 * np.arange(60)))
    plant.hold(controller.last_torques())
    at = rig.references.at(0.36)
    small = 2e-3 * rng.standard_normal((3, 6))
    X = pin.SE3(at.X_WD.rotation @ pin.exp3(small[0, 3:]), at.X_WD.translation + small[0, :3])
    return plant, replace(at, X_WD=X, V_D=at.V_D + small[1], A_D=at.A_D + small[2])


def answered(rig, plant, controller, reference):
    """Signals, reading, and Λ a + b + N α of what the plant does, along S."""
    measurement = plant.measure()
    tau = ticked(controller, measurement, reference)
    s = controller.signals
    _, a, alpha = plant.accelerations(tau)
    state = s.state
    moved = state.Lambda @ a + state.mu + state.p + s.contact.N @ alpha
    reading = s.f_meas - controller.result().bias_out
    return s, reading, state.S.T @ moved


def inertial(s, A):
    """Λ A + b along S of the nearest motion that is possible."""
    state = s.state
    P = solve(state.S.T @ state.metric @ state.S, state.S.T @ state.metric)
    eta = P @ (classical_to_spatial(A, state.V_O) - state.sigma)
    return state.Lambda_S @ eta + state.b_S, P


@parametrize("ratio", [0.0, 0.7])
def test_impedance_is_a_spring_and_a_damper_on_the_arms_own_inertia(rig, ratio):
    """With D the solution of D Λ⁻¹ D = 4ζ²K, here 2ζΛ(Λ⁻¹K)^½, along the motions."""
    for seed in range(4):
        plant, reference = moving(rig, seed)
        controller = rig.controller().with_laws(**vars(osc.impedance(KEYS, ratio)))
        s, _, moved = answered(rig, plant, controller, reference)
        state = s.state
        want, P = inertial(s, reference.A_D)
        w, V = np.linalg.eig(solve(state.Lambda_S, state.S.T * KEYS @ state.S))
        D = 2.0 * ratio * (state.Lambda_S @ V * np.sqrt(w)) @ np.linalg.inv(V)
        e = pose_error(reference.X_WD, state.X_WO)
        spring = KEYS * e + s.contact.N @ s.alpha_d
        want = want + state.S.T @ spring + D @ P @ (reference.V_D - state.V_O)
        assert largest(state.S.T @ (KEYS * e)) > 0.05
        assert_allclose(moved, want, rtol=0, atol=1e-7)


def test_admittance_moves_the_set_point_by_the_force(rig):
    """Two ticks at one instant: c after each by its difference equation."""
    mass, damping, omega, dt = 5.0, 400.0, 2.0 * np.pi * 8.0, 1e-3
    plant, reference = moving(rig, 9)
    law = osc.admittance((mass, mass), (damping, damping), KEYS, 8.0)
    controller = rig.controller().with_laws(**vars(law))
    c = rate = np.zeros(6)
    for _ in range(2):
        s, reading, moved = answered(rig, plant, controller, reference)
        f = s.contact.N @ s.alpha_d - reading
        new = solve(np.diag(mass + dt * damping + dt**2 * KEYS), mass * rate + dt * (f - KEYS * c))
        acceleration = (new - rate) / dt
        c, rate = c + dt * new, new
        X = reference.X_WD
        moved_to = pin.SE3(pin.exp3(c[3:]) @ X.rotation, X.translation + c[:3])
        e = pose_error(moved_to, s.state.X_WO)
        A = reference.A_D + acceleration + omega**2 * e
        A = A + 2.0 * omega * (reference.V_D + rate - s.state.V_O)
        want = inertial(s, A)[0] + s.state.S.T @ reading
        assert_allclose(moved, want, rtol=0, atol=1e-7)
    assert largest(c) > 1e-7


test_numbers_out_of_bounds_are_refused = refusals(
    invalid_input,
    [
        (lambda: osc.impedance((1.0, -1.0)), "stiffness = .*give numbers ≥ 0"),
        (lambda: osc.impedance(np.ones(3)), r"stiffness: expected shape \(6\)"),
        (lambda: osc.impedance(damping_ratio=-0.1), "damping_ratio"),
        (lambda: osc.admittance(mass=(0.0, 1.0)), "mass = .*give numbers > 0"),
        (lambda: osc.admittance(damping=(-1.0, 1.0)), "damping = "),
        (lambda: osc.admittance(frequency=0.0), "frequency = "),
    ],
)

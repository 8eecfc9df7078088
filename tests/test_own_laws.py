"""Custom laws and pairs, impedance and admittance: without shared memory, refused if bad."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
from complaints import invalid_input, refusals
from numpy.linalg import eig, inv, solve
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import fixture
from rigs import assert_near, held_tick, largest, product, refused, rig_of, ticked, vector
from samples import module_fixture, parametrize
from test_moving_face import on_the_move

import osc_contact as osc
from benchmarks.cases import OwnFace
from osc_contact.control.custom_laws import Laws, force_law, motion_law
from osc_contact.interface import Touched
from osc_contact.spatial import classical_to_spatial, pose_error


@module_fixture
def rig():
    changes = ["plant.type=rigid", "plant.step=2 ms", "control.rate=500 Hz"]
    return rig_of("two_contact_rod", *changes)


MADE = []  #: laws


class Seen:
    """Feed-forward plus a constant; counts its calls."""

    def __init__(self):
        self.calls = []
        MADE.append(self)

    def __call__(self, desired, measured):
        self.calls.append((desired, measured))
        return desired + [1.0, -2.0]


@parametrize(
    "law, returned, words",
    [
        ("force", [1.0], "return 2 finite numbers"),
        ("force", [1.0, np.nan], "return 2 finite numbers"),
        ("force", [[1.0, 2.0]], "return 2 finite numbers"),
        ("force", ZeroDivisionError("division by zero"), "division by zero"),
        ("motion", np.zeros(5), "return six finite numbers"),
        ("motion", np.full(6, np.inf), "return six finite numbers"),
        ("structure", (np.zeros(5), np.full(5, np.nan)), "5 finite numbers each"),
        ("structure", (np.zeros(6), np.zeros(5)), "5 finite numbers each"),
        ("structure", None, "5 finite numbers each"),
    ],
)
def test_a_law_that_returns_nonsense_holds_the_torques(rig, law, returned, words):
    def nonsense(*_):
        if isinstance(returned, Exception):
            raise returned
        return returned

    given = (rig.plant().measure(), rig.references.at(0.0))
    controller = rig.controller()
    before = controller.tick(*given)
    controller = controller.with_laws(**{law: nonsense})
    integrals = []
    for _ in range(2):
        assert_array_equal(held_tick(controller, words, *given), before)
        integrals.append([*controller.motion_integral, *controller.force_integral])
    assert_array_equal(*integrals)


def paper(s):
    """Motion filter and control structure, eqs. 24 and 21, in NumPy."""
    N = s.contact.N
    S = s.state.S
    r = N.shape[1]
    weight = S.T @ s.state.metric
    K = np.block([[weight @ S, S.T @ N], [N.T @ S, np.zeros((r, r))]])
    known = (weight @ (s.a_u - s.state.sigma), s.contact.n_gamma - N.T @ s.state.sigma)
    eta = solve(K, np.concatenate(known))[: len(weight)]
    return (eta, s.state.Lambda_S @ eta + s.state.b_S + S.T @ N @ s.alpha_u)


def test_a_motion_law_commands_a_classical_acceleration(rig):
    desired = vector(0.3, -0.5, 0.4, 0.2, 0.6, -0.7)
    read = rig.plant().measure()
    read = replace(read, v=0.1 * default_rng(1).standard_normal(rig.model.nq))
    controller = motion_law(lambda: lambda *_: desired)(rig.controller())
    ticked(controller, read, rig.references.at(0.0))
    s = controller.signals
    assert_near(s.a_u + product(s.state.V_O), desired, atol=1e-12)
    assert largest(product(s.state.V_O)) > 1e-6


class BuiltIn:
    """The force law of fig. 5, without damping."""

    def __init__(self):
        self.sum = np.zeros(2)

    def __call__(self, desired, measured):
        self.sum = self.sum + 30.0 * 2e-3 * (desired - measured)
        return desired + self.sum


def test_the_built_in_laws_written_again_do_the_same_in_closed_loop(rig):
    """One after the other and together, while the plant moves."""
    own = rig.controller().gains.motion.replaced(integral=0.0)
    gains = osc.Gains(own, osc.ForceGains(30.0, 0.0))
    plain = rig.controller().with_gains(gains)

    def motion(reference, X_WO, V_O):
        error = pose_error(reference.X_WD, X_WO)
        return reference.A_D + own.damping * (reference.V_D - V_O) + own.stiffness * error

    others = [
        force_law(BuiltIn)(plain),
        plain.with_laws(motion=motion),
        plain.with_laws(structure=paper),
        plain.with_laws(force=BuiltIn(), structure=paper),
        osc.Controller(
            rig.model,
            rig.pairs,
            gains,
            dt=2e-3,
            posture=rig.q_contact,
            laws=Laws(BuiltIn()),
            reading=plain.reading,
        ),
    ]
    plant = rig.plant()
    for k in range(40):
        reference = rig.references.at(2e-3 * k)
        measurement = plant.measure()
        tau = plain.tick(measurement, reference)
        for other in others:
            assert_near(ticked(other, measurement, reference), tau, atol=1e-8, rtol=0)
        plant.hold(tau)
        plant.command(tau, 2e-3)
    assert largest(plain.force_integral) > 1e-6


def test_laws_stay_when_gains_change_and_can_be_taken_out_again(rig):
    plant = rig.plant()
    reference = rig.references.at(0.0)
    measurement = plant.measure()
    plain = rig.controller()
    other, own = (force_law(Seen)(plain) for _ in range(2))
    other.tick(measurement, reference)
    first, second = MADE[-2:]
    assert_array_equal(first.calls[0][0], reference.alpha_d)
    assert not second.calls, "every controller has its own law"
    changed = own.with_gains(plain.gains.replaced(force=osc.ForceGains(10.0, 5.0)))
    changed.tick(measurement, reference)
    assert_near(changed.signals.alpha_u, reference.alpha_d + [1.0, -2.0], atol=1e-12)
    back = own.with_laws(force=None)
    assert_array_equal(back.tick(measurement, reference), plain.tick(measurement, reference))
    with refused("with_laws"):
        own.laws = Laws()


class Lifted(osc.VertexOnFace):
    """Rubs 0.1 m above its face."""

    def points_of_contact(self, X_WO, X_WE=None):
        R = np.eye(3) if X_WE is None else X_WE.rotation
        return super().points_of_contact(X_WO, X_WE) + 0.1 * (R @ self.normal)[:, None]


@parametrize("kind", [OwnFace, Lifted])
@parametrize("moving", [False, True])
def test_friction_of_ones_own_pairs_is_that_of_the_packaged_one(rig, kind, moving):
    rng = default_rng(60)
    made = [kind(p.vertex, p.point, p.normal, p.radius, name=p.name) for p in rig.pairs]
    reference = rig.references.at(0.0)
    measurement = rig.plant().measure()
    measurement = replace(measurement, v=0.1 * rng.standard_normal(rig.model.nq))
    if moving:
        X = np.array([pin.exp6(0.02 * rng.standard_normal(6)).homogeneous for _ in made])
        V, A = rng.standard_normal((2, len(made), 6))
        measurement = replace(measurement, touched=Touched(X, 0.1 * V, A))
    for friction in (osc.Friction(0.4), None):
        torques = []
        for pairs in (rig.pairs, made, [made[0], rig.pairs[1]]):
            controller = osc.Controller(rig.model, pairs, rig.gains, dt=2e-3, friction=friction)
            torques.append(ticked(controller, measurement, reference))
        assert controller.signals.friction_wrenches.any() == (friction is not None)
        off = [largest(other - torques[0]) for other in torques[1:]]
        assert off[0] > 1e-3 if kind is Lifted and friction is not None else max(off) < 1e-10


# Impedance and admittance: their equations, by what the rigid plant does under them ---------------

KEYS = vector(900.0, 700.0, 500.0, 40.0, 30.0, 20.0)


@fixture(scope="module", params=["two_contact_rod", "panda_edge"])
def exact(request):
    made = rig_of(request.param, "plant.type=rigid", "plant.step=1 ms")
    # viscous friction is compensated along the permitted command, not along the speed read here
    made.chain.model.damping = np.zeros(made.chain.nq)
    return made


def moving(rig, seed):
    """A plant in motion on its contacts, and a reference beside it."""
    plant, controller = on_the_move(rig, start=0.3)
    plant.hold(controller.last_torques())
    at = rig.references.at(0.36)
    small = 2e-3 * default_rng(seed).standard_normal((3, 6))
    X = pin.SE3(at.X_WD.rotation @ pin.exp3(small[0, 3:]), at.X_WD.translation + small[0, :3])
    return (plant, replace(at, X_WD=X, V_D=at.V_D + small[1], A_D=at.A_D + small[2]))


def answered(rig, plant, controller, reference):
    """Signals, reading, and Λ a + b + N α of what the plant does, along S."""
    tau = ticked(controller, plant.measure(), reference)
    s = controller.signals
    _, a, alpha = plant.accelerations(tau)
    state = s.state
    moved = state.Lambda @ a + state.mu + state.p + s.contact.N @ alpha
    reading = s.f_meas - controller.result().bias_out
    return (s, reading, state.S.T @ moved)


def inertial(s, A):
    """Λ A + b along S of the nearest motion that is possible."""
    state = s.state
    P = solve(state.S.T @ state.metric @ state.S, state.S.T @ state.metric)
    eta = P @ (classical_to_spatial(A, state.V_O) - state.sigma)
    return (state.Lambda_S @ eta + state.b_S, P)


@parametrize("ratio", [0.0, 0.7])
def test_impedance_is_a_spring_and_a_damper_on_the_arms_own_inertia(exact, ratio):
    """D solves D Λ⁻¹ D = 4ζ²K, here 2ζΛ(Λ⁻¹K)^½, along the motions."""
    for seed in range(4):
        plant, reference = moving(exact, seed)
        controller = exact.controller().with_laws(**vars(osc.impedance(KEYS, ratio)))
        s, _, moved = answered(exact, plant, controller, reference)
        state = s.state
        expected, P = inertial(s, reference.A_D)
        w, V = eig(solve(state.Lambda_S, state.S.T * KEYS @ state.S))
        D = 2.0 * ratio * (state.Lambda_S @ V * np.sqrt(w)) @ inv(V)
        e = pose_error(reference.X_WD, state.X_WO)
        spring = KEYS * e + s.contact.N @ s.alpha_d
        expected = expected + state.S.T @ spring + D @ P @ (reference.V_D - state.V_O)
        assert largest(state.S.T @ (KEYS * e)) > 0.05
        assert_near(moved, expected, atol=1e-7, rtol=0)


def test_admittance_moves_the_set_point_by_the_force(exact):
    """Two ticks at one instant: c after each by its difference equation."""
    mass, damping, omega, dt = 5.0, 400.0, 2.0 * np.pi * 8.0, 1e-3
    plant, reference = moving(exact, 9)
    law = osc.admittance((mass, mass), (damping, damping), KEYS, 8.0)
    controller = exact.controller().with_laws(**vars(law))
    c = rate = np.zeros(6)
    for _ in range(2):
        s, reading, moved = answered(exact, plant, controller, reference)
        f = s.contact.N @ s.alpha_d - reading
        new = solve(np.diag(mass + dt * damping + dt**2 * KEYS), mass * rate + dt * (f - KEYS * c))
        acceleration = (new - rate) / dt
        c, rate = c + dt * new, new
        X = reference.X_WD
        moved_to = pin.SE3(pin.exp3(c[3:]) @ X.rotation, X.translation + c[:3])
        e = pose_error(moved_to, s.state.X_WO)
        A = reference.A_D + acceleration + omega**2 * e
        A = A + 2.0 * omega * (reference.V_D + rate - s.state.V_O)
        expected = inertial(s, A)[0] + s.state.S.T @ reading
        assert_near(moved, expected, atol=1e-7, rtol=0)
    assert largest(c) > 1e-7


test_numbers_out_of_bounds_are_refused = refusals(
    invalid_input,
    {
        "stiffness = .*give numbers ≥ 0": lambda: osc.impedance((1.0, -1.0)),
        r"stiffness: expected shape \(6\)": lambda: osc.impedance(np.ones(3)),
        "damping_ratio": lambda: osc.impedance(damping_ratio=-0.1),
        "mass = .*give numbers > 0": lambda: osc.admittance(mass=(0.0, 1.0)),
        "damping = ": lambda: osc.admittance(damping=(-1.0, 1.0)),
        "frequency = ": lambda: osc.admittance(frequency=0.0),
    },
)

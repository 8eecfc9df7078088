"""Joint friction: what is learned, against least squares in NumPy; what it brings, in MuJoCo."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pytest import mark, raises
from rigs import one_panda
from test_joint_numbers import DRY, VISCOUS, panda

import osc_contact as osc
from benchmarks.joint_friction import cases
from osc_contact.law import joint_friction
from osc_contact.law.jit import as_python
from osc_contact.law.records import FRICTION

CASES = {case.name: case for case in cases()}
MOST = 30.0


def learned(x, y, r, noise=0.1, dt=0.0):
    """FRICTION after these residuals; dt = 0: nothing is forgotten."""
    row = np.zeros(1, FRICTION).view(np.recarray)[0]
    row.P00, row.P11, row.P22 = 9.0, 4.0, 0.01
    regress = as_python(joint_friction._regress)
    for a, b, c in zip(x, y, r, strict=True):
        regress(row, a, b, c, noise, dt, MOST)
    return np.array([row.dry, row.viscous, row.bias]), row


def test_the_estimate_is_that_of_least_squares():
    """θ = (ΦᵀΦ/R + P₀⁻¹)⁻¹Φᵀr/R, as long as no bound is met."""
    rng = np.random.default_rng(4)
    y = rng.uniform(-2.0, 2.0, 300)
    Phi = np.column_stack([np.sign(y), y, np.ones(300)])
    r = Phi @ [3.0, 1.5, 0.1] + rng.normal(scale=0.3, size=300)
    theta, row = learned(Phi[:, 0], y, r)
    P = np.linalg.inv(Phi.T @ Phi / 0.1 + np.diag([1 / 9.0, 1 / 4.0, 100.0]))
    assert_allclose(theta, P @ Phi.T @ r / 0.1, rtol=1e-9)
    assert_allclose([row.P00, row.P01, row.P12], [P[0, 0], P[0, 1], P[1, 2]], rtol=1e-7)


@mark.parametrize("dt", [0.0, 1e-3])
def test_joints_without_friction_learn_none(dt):
    """F and D at their bound do not drift, though one direction of θ is hardly excited."""
    t = np.linspace(0.0, 3.0, 3000)
    y = 0.6 + 0.1 * np.sin(t)
    r = 2e-3 * np.sin(7.0 * t) - 1e-3
    (F, D, _), _ = learned(np.ones(3000), y, r, noise=2e-3, dt=dt)
    assert 0.0 <= F < 1e-3 * MOST and 0.0 <= D < 1e-3 * MOST


@mark.parametrize(
    "name",
    [
        "rotors ur10 x0.5",
        "rotors xarm7 x0",
        "bare panda x1.5",
        "reversals ur10 2 Hz x0.5",
        "unknown xarm7 2 % of the limit",
        "noise panda 20 bit, 0.05 N, 3 ms",
        "force step ur10 x0.5",
        "two arms two_contact_rod x1.5",
    ],
)
def test_forces_are_held_although_friction_is_believed_wrongly(name):
    rms, _, closed, word = CASES[name].run()
    assert rms <= CASES[name].most and closed == 100.0 and word == "OK"


def test_what_was_learned_is_the_start_of_the_next_controller():
    chain = panda(damping=VISCOUS, friction=DRY)
    controller = osc.Controller(chain, [])
    assert_array_equal(controller.joint_friction, np.column_stack([DRY, VISCOUS]))
    memory = controller._records.memory.friction
    memory.known[2] = 1
    memory.dry[2] = 7.0
    assert controller.joint_friction[2, 0] == 7.0
    friction, damping = controller.joint_friction.T
    again = osc.Controller(panda(damping=damping, friction=friction), [])
    assert_array_equal(again.joint_friction, [*zip(friction, damping, strict=True)])
    controller.reset()
    assert controller.joint_friction[2, 0] == 7.0, "a stop does not change the joints"


def test_settings_out_of_range_are_refused():
    for wrong in ({"share": 1.0}, {"most": 0.0}, {"smoothing": -1.0}):
        with raises(osc.InvalidInputError, match=next(iter(wrong))):
            osc.JointFriction(**wrong)
    assert osc.Controller(one_panda(), [], joint_friction=False).settings.joint_friction is None

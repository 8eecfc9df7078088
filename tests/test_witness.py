"""Contact made beside others: not by what friction of the closed contacts explains."""

import numpy as np
import pinocchio as pin
from numpy.random import default_rng
from rigs import UNLIMITED, panda_pair, posed, shift, vector
from samples import first, parametrize

import osc_contact as osc
from benchmarks.handovers import APART, MEETING, Handover, scenario_of
from osc_contact.law.phases import APPROACHING, CLOSED

PRESSED = 6.0  # N, of the closed contact
BOUND = osc.PhaseSettings().friction_bound


def touched(line, tangential, second, ticks=1):
    """Force read beyond the closed contact, its explained part (N), the reason; whether closed.

    Args:
        line: (3,) where the second line of force, along x, passes, from the first contact (m).
        tangential: force along x at the first contact (N).
        second: of the second contact (N).
        ticks: with these readings.
    """
    chain = panda_pair()
    q, _, X = posed(chain, default_rng(1))
    R = X.rotation
    first = vector(0.0, 0.0, -0.05)
    up, along = (R @ vector(0.0, 0.0, 1.0), R @ vector(1.0, 0.0, 0.0))
    other = first + line
    pairs = [
        osc.VertexOnFace(first, X.act(first), up),
        osc.VertexOnFace(other, X.act(other), -along),
    ]
    how = {"life": osc.PhaseSettings(), "posture": q, "safety": UNLIMITED}
    controller = osc.Controller(chain, pairs, reading="least_squares", joint_friction=False, **how)
    memory = controller.records.memory
    memory.contacts.phase[:] = (CLOSED, APPROACHING)
    memory.contacts.since[:] = 0.0
    memory.columns.closed[:] = (1, 0)
    state = chain.state(q)
    pushes = ((first, -PRESSED * up + tangential * along), (other, second * along))
    wrench = np.zeros(6)  # that the object exerts on the faces
    for point, force in pushes:
        arm = R @ point
        wrench += np.append(force, np.cross(arm, force))
    read = state.sensors[0].inverse() * shift(X.translation)
    still = controller.tick(
        osc.Measurement(q, 0.0 * q, np.zeros((2, 6))), osc.Reference(X, alpha_d=[6.0, 2.0])
    )
    assert np.isfinite(still).all()
    bias = controller.result().bias_out
    wrenches = np.array([read.act(pin.Force(wrench + bias)).vector, np.zeros(6)])
    for _ in range(ticks):
        controller.tick(osc.Measurement(q, 0.0 * q, wrenches), osc.Reference(X, alpha_d=[6.0, 2.0]))
    found = controller.records.work.columns[1]
    closed = controller.phases()[1] == CLOSED
    return (float(found.touch), float(found.explained), controller.reason, closed)


@parametrize("share", [-1.0, 0.3, 1.0])
def test_friction_is_no_contact_where_lines_of_action_do_not_meet(share):
    """It is not seen at all; a contact of 1 N is."""
    apart = vector(0.05, 0.06, 0.04)
    touch, explained, *_ = touched(apart, share * BOUND * PRESSED, 0.0)
    assert abs(touch) < 0.2 and explained < 0.3
    touch, explained, *_ = touched(apart, share * BOUND * PRESSED, 1.0)
    assert touch - explained > 0.6


def test_lines_that_meet_are_told_apart_by_the_bound_only():
    meeting = vector(0.05, 0.0, 0.0)
    touch, explained, why, closed = touched(meeting, 0.9 * BOUND * PRESSED, 0.0, 30)
    assert touch > 1.0 and touch - explained < 0.6 and not closed
    assert "is not made: it reads" in why and f"friction_bound = {BOUND:g}" in why
    touch, explained, *_ = touched(meeting, 0.0, BOUND * PRESSED + 1.0)
    assert touch - explained > 0.6
    *_, closed = touched(meeting, 0.0, BOUND * PRESSED + 1.0, 50)
    assert closed


@parametrize("friction", first([0.5, 0.2, 0.0], 1))
def test_a_missing_contact_reads_next_to_nothing_and_is_not_closed_in_the_air(friction):
    """On MuJoCo, with noise and joint friction, where lines of force pass 30 mm apart."""
    found = Handover.of(osc.run(scenario_of(APART, friction, seconds=2.5)))
    assert found.closed_in_the_air == 0.0 and found.share < 0.1


@parametrize("friction", [0.2, *first([0.5, 0.0], 1)])
def test_no_contact_is_closed_in_the_air_where_lines_meet(friction):
    """On MuJoCo: stick and slip accelerate the tool, whose pitch moves the lines apart."""
    found = Handover.of(osc.run(scenario_of(MEETING, friction, seconds=3.0)))
    assert found.closed_in_the_air == 0.0


@parametrize("seed", first([0, 2, 3], 1))
def test_a_contact_is_closed_soon_after_it_touches(seed):
    """Beside stiction, which holds an approach at rest with less than makes contact."""
    found = Handover.of(osc.run(scenario_of(APART, 0.2, seconds=4.0), seed=seed))
    assert found.closed_in_the_air == 0.0 and found.delay() < 0.05


def test_noise_of_the_wrist_is_taken_at_the_sensor():
    """Where lines pass 3 mm apart noise of the force, with its lever, hides the contact."""
    close = touched(vector(0.05, 0.003, 0.0), 0.0, 0.0, 30)[1]
    far = touched(vector(0.05, 0.06, 0.04), 0.0, 0.0, 30)[1]
    assert close > 0.9 * BOUND * PRESSED and far < 0.3

"""Faces pulled away under every packaged scenario: nothing runs away; pushes: back in contact."""

import numpy as np
from pytest import mark
from rigs import rig_of, unit
from samples import chosen, first, parametrize

import osc_contact as osc
from benchmarks.fault_injection import ClosedLoop
from benchmarks.pushes import packaged, push_arm, table
from osc_contact.control.status import Phase
from osc_contact.runs.run import start

WITH_CONTACTS = [name for name in packaged() if osc.load_scenario(name).contacts]

#: what came out worst in `benchmarks/pushes.py`
WORST = (
    ("dual_panda_rod", "off", 200.0, 0.1),
    ("ur5_wipe", "off", 60.0, 0.1),
    ("two_contact_rod", "along", 200.0, 0.1),
    ("panda_edge", "along", 200.0, 0.05),
    ("three_arm_plate", "into", 200.0, 0.05),
    ("moving_face", "into", 60.0, 0.05),
)


def pull_away(name, by):
    """Take every face `by` (m) away from the object in contact, and continue for a second.

    Returns:
        The controller, joint speeds as shares of their limits, share of ticks that some contact was
        known to be lost.
    """
    loop = ClosedLoop(rig_of(name))
    rig = loop.rig
    controller = loop.controller
    dt = loop.dt
    held = 0
    last = None
    lost = 0
    seen = []
    while last is None or loop.k < last:
        reference = loop.advance()
        closed = (controller.phases() == Phase.CLOSED).all() and controller.engaged
        held = held + 1 if closed and (np.asarray(reference.alpha_d) > 1.0).any() else 0
        if last is None and held * dt > 0.5:
            last = loop.k + round(1.0 / dt)
            lines = rig.contact.N[:3]
            for i in range(len(rig.bodies)):
                into = lines[:, [rig.on[o] == i for o in rig.owners]].sum(axis=1)
                model = loop.true.model
                model.body_pos[model.body(f"face{i}/root").id] += by * unit(into)
        elif last is not None:
            lost += not closed
            seen.append(loop.speed())
        assert loop.k * dt < rig.scenario.duration, "it never was in contact"
    return controller, seen, lost / len(seen)


@parametrize("name", chosen(WITH_CONTACTS, "two_contact_rod", "ur5_wipe", "hinge_ball_rod"))
def test_a_face_that_is_pulled_away_is_looked_for_or_the_arms_stop(name):
    controller, speeds, lost = pull_away(name, 0.2)
    assert max(speeds) < 1.0
    assert controller.state is osc.SafetyState.SAFE_STOP or lost > 0.7, (lost, controller.reason)


@parametrize("name", ["two_contact_rod", "dual_panda_rod"])
def test_a_face_that_is_near_is_found_again(name):
    controller, speeds, lost = pull_away(name, 0.005)
    assert max(speeds) < 0.5 and 0.05 < lost < 0.9
    assert (controller.phases() == Phase.CLOSED).all()


def test_a_contact_that_is_not_found_again_stops_the_arms_until_a_reset():
    rig = rig_of("two_contact_rod")
    plant, controller = start(rig, 0)
    rows = controller._records
    for k in range(30):
        if k == 20:
            rows.memory.contacts.since[:] = 0.0
            rows.memory.columns.time_since_loss[0] = 0.99
        plant.command(controller.tick(plant.measure(), rig.references.at(0.001 * k)), 0.001)
        assert controller.state is not osc.SafetyState.SAFE_STOP
    rows.memory.columns.time_since_loss[0] = 1.01
    for _ in range(2):
        controller.tick(plant.measure(), rig.references.at(0.03))
    assert controller.state is osc.SafetyState.SAFE_STOP
    assert "not held again 1 s after it was lost" in controller.reason
    controller.reset()
    assert (rows.memory.columns.time_since_loss == 0.0).all()
    controller.tick(plant.measure(), rig.references.at(0.03))
    assert controller.state is osc.SafetyState.RUN


@parametrize("push", first(WORST))
def test_pushes_end_in_contact_or_in_a_stop(push):
    found = push_arm(*push)
    assert not found.wrong, table([found])


@mark.slow
def test_a_push_without_limits_and_phases_is_found_wrong():
    """The judge sees what it is there to see."""
    off = [f"control.safety.{key}=100 s" for key in ("contact_loss_time", "overspeed_time")]
    off += ["control.life=off", "control.safety.contact_power=1e9", "control.safety.brake_time=0"]
    assert push_arm("dual_panda_rod", "off", 1000.0, 0.1, off).wrong

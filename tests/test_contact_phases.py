"""Contacts opened, approached and closed one by one: the law's ticks, and the plant.

The rules of the phases themselves are in test_law_phases.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from readable.contact_phases import phases
from readable.low_pass import FilteredForce, filter_force
from rigs import panda_pair, random_faces, random_state, scara_pair
from test_law import agree, disturb, inputs, readable_of, twins

import osc_contact as osc
from osc_contact.control.force import ForceGains
from osc_contact.control.friction import Friction
from osc_contact.control.phases import Phase, PhaseSettings
from osc_contact.runs.run import start
from paper.contact_phases import (
    answers,
    collisions,
    draw_collisions,
    draw_landing,
    false_alarms,
    land,
)

DT = 1e-3
OPEN, APPROACHING, CLOSED = Phase


def test_the_inertia_of_a_flying_object_is_not_heard_as_contact():
    """Free flight at 3 m/s² shows m a on the sensor of fig. 5; heard is the contact force only."""
    t = np.arange(400) * DT
    mass, push = 2.5, np.where(t > 0.3, 8.0, 0.0)
    rate = np.where(t < 0.2, 3.0, 0.0)
    speed = np.cumsum(rate) * DT
    shown = push + mass * rate
    state, found = FilteredForce.nothing(1), []
    here = np.array([True])
    for a, v in zip(shown, speed, strict=True):
        state, force = filter_force(
            state, np.array([a]), np.array([v]), np.eye(1) * mass, here, DT, 0.006
        )
        found.append(force[0])
    found = np.array(found)
    assert np.abs(found[60:300]).max() < 1e-3 * mass * 3.0 + 0.01
    assert found[-1] == pytest.approx(8.0, rel=1e-4)


def test_settings_that_cannot_work_are_refused():
    with pytest.raises(osc.InvalidInputError, match="raise speed or damping"):
        PhaseSettings(speed=0.001)
    with pytest.raises(osc.InvalidInputError, match="rise"):
        PhaseSettings(rise=0.0)


# --- the law on random masks ----------------------------------------------------------------------


def given_phases(phase, fast, slow, since=0.02):
    """The same phases in the law and in NumPy; none is judged before the next tick."""
    rows = fast._records
    rows.contacts.phase, rows.contacts.since, rows.memory.fresh = phase, since, 0
    slow.life.state = replace(slow.life.state, phase=phase, since=np.full(len(phase), since))
    slow.ticked = False


@pytest.mark.parametrize("chain", [scara_pair, panda_pair])
def test_random_masks_as_in_numpy(chain):
    """Faces, and an edge and a triangle that count as one contact each."""
    chain, rng = chain(), np.random.default_rng(51)
    done = seen = 0
    while done < 25:
        q, v = random_state(chain, rng)
        X = chain.state(q, v).X_WO
        pairs = random_faces(X, 2, rng)
        p, n = 0.1 * rng.normal(size=3), rng.normal(size=3)
        several = [osc.FaceOnFace(p, n, X.act(p), -X.rotation @ n)]
        several += [osc.EdgeOnFace(p, rng.normal(size=3), X.act(p), rng.normal(size=3))]
        pairs += several[: 1 + done % 2] if chain.nq > 10 else several[1:]
        owners = np.repeat(np.arange(len(pairs)), [len(pair.gaps(X)) for pair in pairs])
        fast, slow = twins(chain, pairs, life=PhaseSettings())
        disturb(rng, fast, slow)
        measurement, reference = inputs(chain, q, v, rng, len(owners))
        phase = rng.integers(0, 3, len(pairs))
        given_phases(phase, fast, slow)
        slow.tick(measurement, reference)
        if slow.status is osc.Status.HELD:
            continue  # too many columns for this chain, or out of its reach
        slow.motion_law.integral, slow.ticked = fast.motion_law.integral.copy(), False
        slow.force_law.integral = np.zeros(0)
        agree(fast, slow, measurement, reference, 1e-10)
        assert len(slow.signals.alpha_u) == slow.signals.contact.r
        assert len(fast.signals.alpha_u) == fast.signals.contact.r == slow.signals.contact.r
        assert slow.terms.active.tolist() == (phase > 0).tolist()
        seen |= 1 << int((phase > 0).sum())
        done += 1
    assert seen & 0b0110  # some were in and some out


@pytest.mark.parametrize("friction", [None, Friction(0.4)])
def test_a_table_with_some_legs_up_as_in_numpy(friction):
    chain, rng = panda_pair(), np.random.default_rng(52)
    for _ in range(8):
        q, v = random_state(chain, rng)
        X = chain.state(q, v).X_WO
        n = X.rotation @ np.array([0.0, 0.0, 1.0])
        spots = np.column_stack((rng.uniform(-0.2, 0.2, (5, 2)), np.full(5, -0.05)))
        pairs = [osc.VertexOnFace(p, X.act(p), n, name=f"leg{i}") for i, p in enumerate(spots)]
        fast, slow = twins(chain, pairs, friction=friction, life=PhaseSettings())
        disturb(rng, fast, slow)
        given_phases(rng.integers(0, 3, 5), fast, slow)
        agree(fast, slow, *inputs(chain, q, v, rng, 5))


@pytest.mark.parametrize("friction", [None, Friction(0.4)])
def test_random_masks_as_in_numpy_when_motors_are_at_their_limits(friction):
    """Which contacts may lose force is told by the mask, too."""
    chain, rng = scara_pair(), np.random.default_rng(55)
    done = 0
    while done < 6:
        q, v = random_state(chain, rng)
        pairs = random_faces(chain.state(q, v).X_WO, 3, rng)
        fast, slow = twins(chain, pairs, friction=friction, life=PhaseSettings())
        measurement, reference = inputs(chain, q, v, rng, 3)
        reference = replace(reference, alpha_d=200.0 * reference.alpha_d)
        phase = rng.integers(0, 3, 3)
        given_phases(phase, fast, slow, since=1.0)
        if np.count_nonzero(phase) in (0, 3) or CLOSED not in phase:
            continue
        want = slow.tick(measurement, reference)
        if slow.status is not osc.Status.SATURATED:
            continue
        got = fast.tick(measurement, reference)
        assert fast.status is osc.Status.SATURATED
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-6 * np.abs(want).max())
        np.testing.assert_allclose(fast.given_up.force, slow.given_up.force, rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(
            fast.force_law.integral, slow.force_law.integral, rtol=1e-5, atol=1e-3
        )
        done += 1


def test_an_open_contact_moves_as_if_its_face_were_not_there():
    """The controller with one face open gives the torques of one that never knew of it."""
    chain, rng = scara_pair(), np.random.default_rng(53)
    q, v = random_state(chain, rng)
    pairs = random_faces(chain.state(q, v).X_WO, 2, rng)
    measurement, reference = inputs(chain, q, v, rng, 2)
    knowing = twins(chain, pairs, life=PhaseSettings())
    blind = twins(chain, pairs[:1], reading="filter")
    given_phases(np.array([CLOSED, OPEN]), *knowing, since=1.0)
    for both, one in zip(knowing, blind, strict=True):
        got = both.tick(measurement, reference)
        want = one.tick(measurement, replace(reference, alpha_d=reference.alpha_d[:1]))
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("law", ["law", "numpy"])
def test_a_closed_contact_never_pulls_and_its_integral_does_not_run_away(law):
    chain, rng = scara_pair(), np.random.default_rng(54)
    q, _ = random_state(chain, rng)
    v = np.zeros(chain.nq)
    pairs = random_faces(chain.state(q, v).X_WO, 2, rng)
    gains, k = osc.Gains(force=ForceGains(30, 0)), PhaseSettings()
    controller = osc.Controller(chain, pairs, gains, life=k)
    if law == "numpy":
        controller = readable_of(controller)
    measurement, reference = inputs(chain, q, v, rng, 2)
    s = chain.state(q, v)
    quiet = replace(measurement, wrenches=np.zeros((2, 6)))
    controller.tick(quiet, reference)
    load = controller.signals.contact.N @ np.array([60.0, 60.0])
    R, p = s.sensors[0].rotation, s.sensors[0].translation
    moment = load[3:] - np.cross(p - s.X_WO.translation, load[:3])
    wrenches = np.array([np.concatenate((R.T @ load[:3], R.T @ moment)), np.zeros(6)])
    pressed = replace(measurement, wrenches=wrenches)
    for _ in range(300):
        controller.tick(pressed, reference)
    np.testing.assert_allclose(controller.signals.alpha_u, k.least)
    wanted = reference.alpha_d + controller.force_law.integral
    assert (wanted > k.least - 30.0 * DT * 60.0).all()


def test_a_knocked_rod_as_in_numpy_tick_by_tick():
    """Contacts opened, approached, made and lost on the plant; without a motion integral."""
    rig = osc.build_rig(osc.load_scenario("collisions", ["gains.motion.integral=0"]))
    fast = rig.controller().with_safety(osc.SafetySettings.motors_only())
    slow, plant, seen = readable_of(fast), rig.plant(), set()
    for k in range(1500):
        measurement, reference = rig.at_start(plant.measure()), rig.references.at(DT * k)
        got, want = fast.tick(measurement, reference), slow.tick(measurement, reference)
        assert fast.status is slow.status, (k, fast.reason, slow.reason)
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-9 * np.abs(want).max())
        now = fast._records.contacts.phase.copy()
        np.testing.assert_array_equal(now, phases(slow))
        seen.add(tuple(now))
        plant.command(got, DT)
    assert len(seen) > 1, seen


# --- on MuJoCo ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["two_contact_rod", "dual_panda_rod", "ur5_wipe", "limited_rod"])
def test_phases_change_nothing_while_contacts_stay_closed(name):
    """Filter and least squares, several columns, motors at their limits: bit for bit."""
    at_once = "gains.force.rise=0 s"  # or the first millinewtons would open a contact
    rig = osc.build_rig(osc.load_scenario(name, [at_once]))
    bare = osc.build_rig(osc.load_scenario(name, [at_once, "control.life=off"]))
    plant, controller = start(rig)
    other = start(bare)[1]
    assert controller.life is not None and other.life is None
    plan = rig.references.over(np.arange(2300) * DT)
    for k in range(2300 if name == "limited_rod" else 700):
        measurement = plant.measure()
        tau, want = (c.tick(measurement, plan[k]) for c in (controller, other))
        np.testing.assert_array_equal(tau, want)
        plant.command(tau, DT)
    assert (controller.phases() == CLOSED).all()


@pytest.mark.parametrize("reading", ["filter", "least_squares"])
def test_mobility_is_what_an_acceleration_in_flight_adds_to_the_forces_read(reading):
    """Beside Λ_out of the readable chain: the object accelerates by x along its lines of force."""
    chain, rng = panda_pair(), np.random.default_rng(57)
    q, _ = random_state(chain, rng)
    v = np.zeros(chain.nq)
    pairs = random_faces(chain.state(q, v).X_WO, 2, rng)
    controller = osc.Controller(chain, pairs, reading=reading, life=PhaseSettings())
    measurement, reference = inputs(chain, q, v, rng, 2)
    state, x = chain.state(q, v), rng.normal(size=2)
    controller.tick(measurement, reference)
    before, N = controller.result().alpha_meas.copy(), controller.signals.contact.N
    D = controller._records.work.mobility[:2, :2].copy()
    Phi = np.linalg.inv(state.payload.Lambda)
    seen = state.Lambda_out @ Phi @ N @ np.linalg.solve(N.T @ Phi @ N, x)
    sensor = state.sensors[0]
    moment = seen[3:] - np.cross(sensor.translation - state.X_WO.translation, seen[:3])
    added = np.concatenate((sensor.rotation.T @ seen[:3], sensor.rotation.T @ moment))
    wrenches = measurement.wrenches + np.array([added, np.zeros(6)])
    controller.tick(replace(measurement, wrenches=wrenches), reference)
    found = controller.result().alpha_meas - before
    np.testing.assert_allclose(D @ found, x, rtol=1e-7, atol=1e-9)


@pytest.fixture(scope="module")
def knocked():
    return osc.run(osc.load_scenario("collisions"), duration=2.5)


def test_every_collision_of_a_knocked_rod_is_flagged_in_time(knocked):
    """The plant's own contacts are the judge: re-made after ≥ 10 ms, at ≥ 10 mm/s."""
    recording, hits = knocked, collisions(knocked)
    assert {hit.contact for hit in hits} == {0, 1} and len(hits) >= 3
    assert all(hit.flagged is not None and hit.flagged <= 0.02 for hit in hits)
    assert all(hit.power > 0.02 for hit in hits)
    assert (recording["status"] == 0).all()


def test_figure_7_shows_power_peaks_at_the_collisions(knocked):
    """Projected power: quiet while contacts hold, a peak at each collision."""
    t, power = knocked["t"], np.abs(knocked["power_projected"])
    hits = collisions(knocked)
    held = knocked["closed"].all(axis=1) & (t > 0.3)
    for hit in hits:
        held &= (t < hit.t - 0.3) | (t > hit.t + 0.15)
    assert held.sum() > 300
    for hit in hits:
        assert hit.power > 4.0 * np.percentile(power[held], 99)
        assert power[np.abs(t - hit.t) <= 0.02].max() == pytest.approx(hit.power)
    assert all(answer.holds for answer in answers(knocked).values())
    figure = draw_collisions(knocked)
    total, projected, force = (ax.get_title(loc="left") for ax in figure.axes)
    assert total.startswith("total") and projected.startswith("projected") and "force" in force


def test_counts_of_collisions_and_alarms_on_a_made_up_recording():
    """Met fast, open for 5 ms only, met slowly, met fast; flags in time, too late, for nothing."""
    ticks = 400
    closed, speed = np.ones((ticks, 1), dtype=bool), np.zeros(ticks)
    for lost, made, met in ((50, 70, 0.05), (120, 125, 0.05), (200, 230, 0.002), (300, 330, 0.02)):
        closed[lost:made], speed[made - 2 : made] = False, met
    flags = np.zeros((ticks, 1), dtype=bool)
    flags[[75, 355, 390], 0] = True
    N = np.zeros((ticks, 6, 1))
    N[:, 2] = 1.0
    twist = np.zeros((ticks, 6))
    twist[:, 2] = speed
    recording = osc.Recording(
        {"control_rate_hz": 1000.0},
        {"t": np.arange(ticks) * DT, "closed": closed, "collision_seen": flags, "N": N,
         "twist": twist, "power_projected": np.zeros(ticks)},
    )  # fmt: skip
    found = [
        (round(hit.t, 3), hit.flagged and round(hit.flagged, 3)) for hit in collisions(recording)
    ]
    assert found == [(0.07, 0.005), (0.33, None)]
    assert false_alarms(recording) == 2


def test_a_landing_is_soft_and_torques_do_not_jump():
    found = land(3)
    row, recording = found.as_dict(), found.recording
    assert row["success"], row
    assert len(draw_landing([found]).axes) == 4
    assert row["peak_over_command"] <= 2.0
    assert row["torque_rate"] <= row["torque_rate_limit"] * (1 + 1e-9)
    open_at_first = recording["contact_phase"][recording["t"] < 0.39]
    assert (open_at_first == OPEN).all()
    changes = np.flatnonzero(np.abs(np.diff(recording["contact_phase"], axis=0)).any(axis=1))
    jumps = np.abs(np.diff(recording["tau"], axis=0)).max(axis=1)
    assert len(changes) >= 3
    assert (jumps[np.clip(changes, 0, len(jumps) - 1)] < 4.0 + 1e-9).all()  # N, N m

"""Contacts opened, approached and closed one by one: the law's ticks, and the plant.

The rules of the phases themselves are in test_law_phases.py.
"""

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.linalg import inv, solve
from numpy.random import default_rng
from numpy.testing import assert_array_equal
from pytest import approx
from rigs import (
    UNLIMITED,
    assert_near,
    largest,
    panda_pair,
    posed,
    random_faces,
    random_state,
    refused,
    rig_of,
    scara_pair,
    shift,
    vector,
)
from samples import aligned, module_fixture, parametrize
from scenario_runs import run_of
from test_law import inputs

import osc_contact as osc
from osc_contact.control.status import Phase
from osc_contact.lab.runs.run import start
from osc_contact.settings.control import Friction, PhaseSettings
from paper.contact_phases import answers, collisions, draw_collisions, false_alarms

DT = 1e-3
OPEN, APPROACHING, CLOSED = Phase


def test_settings_that_cannot_work_are_refused():
    with refused("raise speed or damping"):
        PhaseSettings(speed=0.001)
    with refused("rise"):
        PhaseSettings(rise=0.0)


# --- the law on random masks ----------------------------------------------------------------------


def given_phases(controller, phase):
    """Phases of long ago; none is judged before the next tick."""
    rows = controller.records
    rows.memory.contacts.phase = phase
    rows.memory.contacts.since = 1.0
    rows.memory.fresh = 0


@parametrize("times", [1.0, 200.0])
@parametrize("friction", [None, Friction(0.4)])
@parametrize("chain", [scara_pair, panda_pair])
def test_an_open_contact_moves_as_if_its_face_were_not_there(chain, friction, times):
    """Torques of a controller that never knew of the open ones, also with too weak motors.

    Vertices, an edge and a triangle that count as one contact each, and legs that depend.
    """
    chain = chain()
    rng = default_rng(51)
    seen = set()
    for k in range(32):
        q, v, X = posed(chain, rng)
        pairs = random_faces(X, 2, rng)
        p = 0.1 * rng.standard_normal(3)
        n = rng.standard_normal(3)
        if friction is None:
            kinds = (
                osc.FaceOnFace(p, n, X.act(p), -X.rotation @ n),
                osc.EdgeOnFace(p, rng.standard_normal(3), X.act(p), rng.standard_normal(3)),
            )
            pairs.append(kinds[k % 2])
        elif chain.nq > 10:
            spots = np.column_stack((rng.uniform(-0.2, 0.2, (4, 2)), np.full(4, -0.05)))
            up = X.rotation @ vector(0.0, 0.0, 1.0)
            pairs = [osc.VertexOnFace(spot, X.act(spot), up) for spot in spots]
        owners = np.repeat(np.arange(len(pairs)), [len(pair.gaps(X)) for pair in pairs])
        measurement, reference = inputs(chain, q, v, rng, len(owners))
        reference = replace(reference, alpha_d=times * reference.alpha_d)
        closed = rng.random(len(pairs)) < 0.6
        how = {"friction": friction, "reading": "filter", "safety": UNLIMITED}
        knowing = osc.Controller(chain, pairs, life=PhaseSettings(), **how)
        few = [pair for pair, here in aligned(pairs, closed) if here]
        blind = osc.Controller(chain, few, life=PhaseSettings(), **how)
        given_phases(knowing, np.where(closed, CLOSED, OPEN))
        given_phases(blind, np.full(len(few), CLOSED))
        got = knowing.tick(measurement, reference)
        expected = blind.tick(
            measurement, replace(reference, alpha_d=reference.alpha_d[closed[owners]])
        )
        assert knowing.status is blind.status
        assert_near(got, expected, atol=1e-6 * largest(expected), rtol=0)
        if knowing.status is not osc.Status.HELD:  # else out of reach, or too many columns
            seen |= {(bool(closed.all()), knowing.status)}
            assert len(knowing.signals.alpha_u) == knowing.signals.contact.r
            assert_array_equal(knowing.records.memory.contacts.active, closed)
    assert {osc.Status.OK if times == 1.0 else osc.Status.SATURATED} <= {s for _, s in seen}
    assert {whole for whole, _ in seen} == {False, True}


# --- on MuJoCo ------------------------------------------------------------------------------------


@parametrize("name", ["two_contact_rod", "dual_panda_rod", "ur5_wipe", "limited_rod"])
def test_phases_change_nothing_while_contacts_stay_closed(name):
    """Filter and least squares, several columns, motors at their limits: bit for bit."""
    at_once = "gains.force.rise=0 s"  # or the first millinewtons would open a contact
    rig = rig_of(name, at_once)
    plant, controller = start(rig)
    other = start(rig_of(name, at_once, "control.life=off"))[1]
    assert controller.life is not None and other.life is None
    for reference in rig.references.each(2300 if name == "limited_rod" else 700, DT):
        measurement = plant.measure()
        tau, expected = (c.tick(measurement, reference) for c in (controller, other))
        assert_array_equal(tau, expected)
        plant.command(tau, DT)
    assert_array_equal(controller.phases(), CLOSED)


@parametrize("reading", ["filter", "least_squares"])
def test_mobility_is_what_an_acceleration_in_flight_adds_to_the_forces_read(reading):
    """Beside Λ_out: the object accelerates by x along its lines of force."""
    chain = panda_pair()
    rng = default_rng(57)
    q, _ = random_state(chain, rng)
    v = np.zeros(chain.nq)
    state = chain.state(q, v)
    pairs = random_faces(state.X_WO, 2, rng)
    controller = osc.Controller(chain, pairs, reading=reading, life=PhaseSettings())
    measurement, reference = inputs(chain, q, v, rng, 2)
    x = rng.standard_normal(2)
    controller.tick(measurement, reference)
    before = controller.result().alpha_meas.copy()
    N = controller.signals.contact.N
    D = controller.records.work.mobility[:2, :2].copy()
    Phi = inv(state.payload.Lambda)
    seen = state.Lambda_out @ Phi @ N @ solve(N.T @ Phi @ N, x)
    to_sensor = state.sensors[0].inverse() * shift(state.X_WO.translation)
    first = to_sensor.act(pin.Force(seen)).vector  # the other wrist feels nothing of it
    wrenches = measurement.wrenches + [first, np.zeros(6)]
    controller.tick(replace(measurement, wrenches=wrenches), reference)
    assert_near(D @ (controller.result().alpha_meas - before), x, atol=1e-9, rtol=1e-7)


@module_fixture
def knocked():
    return run_of("collisions", duration=2.5)


def test_every_collision_of_a_knocked_rod_is_flagged_in_time(knocked):
    """The plant's own contacts are the judge: re-made after ≥ 10 ms, at ≥ 10 mm/s."""
    hits = collisions(knocked)
    assert {hit.contact for hit in hits} == {0, 1} and len(hits) >= 3
    assert all(hit.flagged is not None and hit.flagged <= 0.02 for hit in hits)
    assert all(hit.power > 0.02 for hit in hits)
    assert_array_equal(knocked["status"], 0)
    rubs = [f"arms.{arm}.friction=0.3" for arm in ("left", "right")]  # then something is learned
    rubbing = run_of("collisions", *rubs, duration=2.5)
    most = [largest(run["friction"]) for run in (knocked, rubbing)]
    assert most[0] < 3.0 and 0.0 < most[1] < 3.0  # 88 N m if a moment of rest were stiction


def test_figure_7_shows_power_peaks_at_the_collisions(knocked):
    """Projected power: quiet while contacts hold, a peak at each collision."""
    hits = collisions(knocked)
    power = np.abs(knocked["power_projected"])
    for hit in hits:
        assert power[np.abs(knocked["t"] - hit.t) <= 0.02].max() == approx(hit.power)
    assert all(answer.holds for answer in answers(knocked).values())
    figure = draw_collisions(knocked)
    titles = " ".join(ax.get_title(loc="left") for ax in figure.axes)
    assert re.match("total.* projected.* enlarged", titles)
    shown = [line.get_xdata() for line in figure.axes[1].lines if line.get_marker() == "v"]
    assert_array_equal(np.concatenate(shown), [hit.t for hit in hits])


def test_counts_of_collisions_and_alarms_on_a_made_up_recording():
    """Met fast, open for 5 ms only, met slowly, met fast; flags in time, too late, for nothing."""
    ticks = 400
    closed = np.ones((ticks, 1), dtype=bool)
    speed = np.zeros(ticks)
    for lost, made, met in ((50, 70, 0.05), (120, 125, 0.05), (200, 230, 0.002), (300, 330, 0.02)):
        closed[lost:made] = False
        speed[made - 2 : made] = met
    flags = np.zeros((ticks, 1), dtype=bool)
    flags[[75, 355, 390], 0] = True
    N = np.zeros((ticks, 6, 1))
    N[:, 2] = 1.0
    twist = np.zeros((ticks, 6))
    twist[:, 2] = speed
    recording = osc.Recording(
        {"control_rate_hz": 1000.0},
        {
            "t": np.arange(ticks) * DT,
            "closed": closed,
            "collision_seen": flags,
            "N": N,
            "twist": twist,
            "power_projected": np.zeros(ticks),
        },
    )
    found = [
        (round(hit.t, 3), hit.flagged and round(hit.flagged, 3)) for hit in collisions(recording)
    ]
    assert found == [(0.07, 0.005), (0.33, None)]
    assert false_alarms(recording) == 2


def test_an_approach_that_stands_still_names_the_distance_left():
    recording = run_of("approach_and_slide", "control.life.travel=3 mm", duration=1.6)
    assert (recording["contact_phase"][-1] == APPROACHING).any()
    assert (recording["status"] == osc.Status.OK).all() and not recording["alpha_true"].any()
    found = re.findall(
        r"the approach of contact '(\w+)' has covered travel = 3 mm, met nothing and stands still; "
        r"in the model ([\d.]+) mm are left",
        recording.meta["end_reason"],
    )
    assert [name for name, _ in found] == recording.meta["contact_names"]
    assert all(float(left) == approx(3.0, abs=0.5) for _, left in found)  # of 6 mm


def test_a_landing_is_soft_and_torques_do_not_jump():
    start = ("tare.standoff=4.5 mm", "object.pose.rpy.1=8 mrad")
    recording = run_of("approach_and_slide", *start, seed=3)
    command = recording["alpha_cmd"]
    made = max(osc.metrics(recording)["first_contact_s"].values())
    held = (recording["t"] > made + 0.05) & (command > 0.0).any(axis=1)
    assert held.any() and recording["closed"][held].all() and not recording["closed"][-1].any()
    assert largest(recording["alpha_true"]) <= 2.0 * command.max()
    limits = np.array(list(recording.meta["effort_limits"].values()))
    rates = np.abs(np.diff(recording["tau"], axis=0)) / limits / DT
    assert rates.max() <= recording.meta["scenario"]["control"]["life"]["torque_rate"] * (1 + 1e-9)
    assert_array_equal(recording["contact_phase"][recording["t"] < 0.39], OPEN)
    changes = np.flatnonzero(np.abs(np.diff(recording["contact_phase"], axis=0)).any(axis=1))
    jumps = np.abs(np.diff(recording["tau"], axis=0)).max(axis=1)
    assert len(changes) >= 3
    assert (jumps[np.clip(changes, 0, len(jumps) - 1)] < 4.0 + 1e-9).all()  # N, N m

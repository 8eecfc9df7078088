"""Hopping contacts are named: by Drake's SAP contacts, recorded, and by series made for a law."""

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from law_calls import hopping, records, write
from pytest import approx

import osc_contact as osc
from osc_contact import robots
from osc_contact.law.reasons import NO_REASON

parametrize = pytest.mark.parametrize
HOPPING = osc.Status.HOPPING
DT = 1e-3
RADIUS = 0.01
SERIES = Path(__file__).parent / "data" / "drake_sap.npz"
"""A Panda that presses a ball with 10 N and slides it by ± 20 mm at 0.5 Hz, in Drake 1.51.1.

Coefficient of friction 0.2, face 3° off its model; 1,300 ticks of 1 ms from 50 ms before the first
touch on. `sap`: Drake's contact solver SAP with a relaxation time of 0.1 s, by which a slipping
contact bounces; `lagged`: its other one. Columns: q, v (7 each), wrench of the wrist (6); `_force`:
Drake's contact force (N); `first`: number of the first tick.
"""


@cache
def series():
    with np.load(SERIES) as file:
        return {name: file[name].astype(float) for name in file.files}


def panda(q, **limits):
    """Controller of the recorded Panda: vertex on a face 12 mm away from the ball."""
    arm = osc.Arm.from_urdf(
        robots.find_robot("panda")[0],
        name="panda",
        tip="panda_hand_tcp",
        wrist_sensor="panda_link8",
    )
    chain = osc.ClosedChain([arm], payload=osc.RigidObject(pin.Inertia.FromSphere(0.1, RADIUS)))
    X = chain.state(q).X_WO
    out = -X.rotation[:, 2]
    point = X.translation - (0.012 + RADIUS) * out
    wall = osc.VertexOnFace([0, 0, 0], point=point, normal=out, radius=RADIUS, name="wall")
    safety = osc.SafetySettings.motors_only(hop_share=0.3, hop_rate=4.0, **limits)
    return osc.Controller(
        chain, [wall], dt=DT, posture=q, life=osc.PhaseSettings(), safety=safety
    ), X


def replayed(name, **limits):
    """The controller after each tick of a recorded series, and the contact force then (N)."""
    data = series()
    start = np.array([0, 0.1, 0, -2.2, 0, 2.3, 0.8])
    controller, X = panda(start, **limits)
    along = X.rotation[:, 0]
    w = np.pi
    for k, (row, force) in enumerate(zip(data[name], data[f"{name}_force"], strict=True)):
        wt = w * DT * (data["first"] + k)
        target = X.translation + 0.02 * np.sin(wt) * along
        reference = osc.pose_reference(
            target,
            X.rotation,
            0.02 * w * np.cos(wt) * along,
            -0.02 * w * w * np.sin(wt) * along,
            alpha_d=[10.0],
        )
        controller.tick(osc.Measurement(row[:7], row[7:14], row[None, 14:]), reference)
        yield controller, force


def test_the_hops_of_drakes_sap_contact_are_named_within_1_2_s():
    touched = named = None
    for k, (controller, force) in enumerate(replayed("sap")):
        touched = k if touched is None and force > 0.3 else touched
        if named is None and controller.status is HOPPING:
            named = k
            assert controller.reason.startswith(
                "contact 'wall' hops: 30 % of the last second below"
            )
            assert controller.state is osc.SafetyState.RUN  # nothing of the law was given up
    assert touched is not None and named is not None
    assert (named - touched) * DT < 1.2
    assert controller.status is HOPPING
    share = 100 * controller.records.memory.columns.hop_share[0]
    assert controller.reason == (
        f"contact 'wall' hops: {share:.0f} % of the last second below a fifth of its command"
    )
    assert share > 45


def test_a_contact_that_holds_is_not_named():
    assert all(controller.status is not HOPPING for controller, _ in replayed("lagged"))


def test_hops_stop_the_arms_only_by_a_setting():
    assert not osc.SafetySettings().hop_stops
    for controller, _ in replayed("sap", hop_stops=True):
        assert controller.status is not HOPPING
    assert controller.state is osc.SafetyState.SAFE_STOP
    assert "contact 'wall' hops" in controller.reason
    controller.reset()
    assert controller.records.memory.hopping == 0
    assert not controller.records.memory.columns.hop_share.any()


def test_an_event_names_a_hopping_contact_once():
    from osc_contact.control.changes import Changes

    changes = None
    found = []
    for controller, _ in replayed("sap"):
        changes = changes or Changes(controller)
        found += [facts for kind, facts in changes.look() if kind == "hopping"]
    assert len(found) == 1 and "contact 'wall' hops" in found[0]["reason"]


class Column:
    """One column of a contact in force, without contact phases unless they are given."""

    def __init__(self, **more):
        limits = {"period": DT, "hop_share": 0.3, "hop_rate": 4.0}
        self.t = records(contacts=1, columns=1, **limits | more)
        write(self.t.work, rank=1, kept=[0], dt=DT)
        self.t.memory.contacts[0].active = 1
        self.t.memory.contacts[0].phase = 2

    def tick(self, force, command=10.0):
        write(self.t.work, alpha_meas=[force], alpha_d=[command])
        assert hopping.watch_hops(self.t) == NO_REASON
        return self.t.memory.hopping == 1

    def periodic(self, seconds, period, low_share, low=0.0, high=20.0, command=10.0):
        """Whether a periodic force is named; it presses first, then is low, in each period."""
        named = False
        for k in range(round(seconds / DT)):
            phase = (k * DT / period) % 1.0
            named |= self.tick(high if phase >= low_share else low, command)
        return named


@parametrize("sign", [1, -1])
def test_share_and_rate_must_both_be_reached(sign):
    forces = {"high": sign * 20.0, "command": sign * 10.0}
    assert Column().periodic(3.0, 0.1, 0.5, **forces)  # 10 per second, 50 %
    assert not Column().periodic(3.0, 0.1, 0.2, **forces)  # 10 per second, 20 %
    assert not Column().periodic(3.0, 0.5, 0.6, **forces)  # 2 per second, 60 %
    assert Column().periodic(3.0, 0.1, 0.5, low=sign * 1.9, **forces)
    assert not Column().periodic(3.0, 0.1, 0.5, low=sign * 2.1, **forces)


def test_share_and_rate_are_those_of_a_lasting_series():
    column = Column()
    column.periodic(10.0, 0.05, 0.4)
    row = column.t.memory.columns[0]
    assert row.hop_share == approx(0.4, abs=0.02) and row.hop_rate == approx(20.0, abs=1.0)


def test_noise_about_a_fifth_is_no_hop():
    assert not Column().periodic(3.0, 0.01, 0.5, low=1.5, high=4.9)


def test_a_force_that_is_gone_for_good_or_too_small_is_none():
    assert not Column().periodic(3.0, 10.0, 0.99)
    assert not Column().periodic(3.0, 0.1, 0.5, high=2.0, command=1.0)


def test_a_contact_that_phases_approach_again_is_gone():
    column = Column(phased=1)
    named = False
    contact = column.t.memory.contacts[0]
    for k in range(1500):
        contact.phase = 2 if k % 100 >= 50 else 1
        named |= column.tick(20.0 if k % 100 >= 50 else 0.0, 10.0 if k % 100 >= 50 else 0.5)
    assert named
    first = Column(phased=1)
    first.t.memory.contacts[0].phase = 1
    assert not any(first.tick(0.0, 3.0) for _ in range(2000))
    assert first.t.memory.columns[0].hop_share == 0.0


def test_an_opened_contact_begins_anew():
    column = Column()
    assert column.periodic(3.0, 0.1, 0.5)
    column.t.memory.contacts[0].active = 0
    write(column.t.work, rank=0)
    assert not column.tick(0.0)
    assert column.t.memory.columns[0].hop_share == 0.0

"""Scenarios made in Python: pairs, moving bodies and laws of one's own, on both plants."""

import json

import numpy as np
import pinocchio as pin
from complaints import scenario_error
from numpy.testing import assert_allclose
from pytest import mark, raises
from rigs import unit

import osc_contact as osc
from osc_contact.dynamics.environment import Conveyor
from osc_contact.scenarios.signals import MinimumJerk

PLANTS = ("rigid", "mujoco")
SAME = ("q", "tau", "pose", "alpha_true", "alpha_meas", "N", "closed", "contact_point", "face_pose")


class Tip(osc.VertexOnFace):
    """Evaluated by Python."""

    def contact(self, *args):
        return super().contact(*args)


def task(plant, name="two_contact_rod"):
    step = {"rigid": "2 ms", "mujoco": "0.25 ms"}[plant]
    changes = f"plant.type={plant}", f"plant.step={step}", "control.rate=500 Hz", "duration=0.04 s"
    return osc.load_scenario(name, changes)


def on_bodies(scenario, pairs):
    """The same contacts on bodies of the environment instead of faces of their own."""
    bodies = []
    contacts = []
    for pair, body in zip(pairs, osc.build_rig(scenario).bodies, strict=True):
        X = body.placement
        pose = {"xyz": X.translation, "rpy": pin.rpy.matrixToRpy(X.rotation)}
        bodies.append({"name": body.name, "urdf": "face.urdf", "pose": pose})
        contacts.append({"pair": pair, "body": body.name})
    return scenario.replaced(environment=bodies, contacts=contacts)


def assert_same(ours, theirs, atol):
    assert ours.channels.keys() == theirs.channels.keys()
    for name in SAME:
        assert_allclose(ours[name], theirs[name], rtol=0, atol=atol, err_msg=name)


@mark.parametrize("plant", PLANTS)
def test_pairs_of_ones_own(plant):
    plain = task(plant)
    pairs = [
        Tip(p.vertex, p.point, p.normal, p.radius, name=p.name) for p in osc.build_rig(plain).pairs
    ]
    own = on_bodies(plain, pairs)
    ours = osc.run(own)
    assert_same(ours, osc.run(plain), 1e-6)
    assert ours.magnitude_names == ["left_end", "right_end"] and not ours["status"].any()
    contact = json.loads(json.dumps(ours.meta["scenario"]))["contacts"][0]
    assert contact == {"name": "left_end", "body": "face_left_end", "pair": "Tip"}


@mark.parametrize("plant", PLANTS)
def test_bodies_of_ones_own(plant):
    """A face driven by a function, and what the controller makes of it, as of a conveyor."""
    direction = unit(np.array([-0.904196, -0.361677, 0.227199]))
    signal = {"type": "minimum_jerk", "value": 0.005, "start": 0.0, "duration": 0.05}
    scenario = task(plant, "moving_face")

    def with_motion(motion):
        left, right = (contact.model_dump() for contact in scenario.contacts)
        left["face"]["motion"] = motion
        return scenario.replaced(contacts=[left, right])

    def drive(t):
        return np.array([[x, 0.0] for x in MinimumJerk(value=0.005, duration=0.05).at(t)])

    answered = []

    class Belt:
        def environment(self, X_WE, V_E, A_E, O):
            answered.append(V_E)
            return Conveyor().environment(X_WE, V_E, A_E, O)

    own = osc.OwnMotion(osc.Rail(direction, motion=drive), Belt())
    packaged = {"type": "conveyor", "direction": direction, "signals": [signal]}
    ours = osc.run(with_motion(own))
    assert_same(ours, osc.run(with_motion(packaged)), 1e-6)
    assert answered and np.ptp(ours["face_pose"][:, 0, :3], axis=0).max() > 1e-3
    late = osc.OwnMotion(osc.Rail(direction, motion=lambda t: drive(t + 0.02)))
    with scenario_error("away from where the contacts touch"):
        osc.build_rig(with_motion(late)).plant()


@mark.parametrize("plant", PLANTS)
def test_laws_of_ones_own(plant):
    plain = task(plant)
    made = []

    class Proportional:
        def __init__(self):
            made.append(self)
            self.calls = 0

        def __call__(self, desired, measured):
            self.calls += 1
            return desired + 0.2 * (desired - measured)

    ours = osc.run(plain.replaced(laws=lambda: osc.Laws(force=Proportional())))
    theirs = osc.run(plain, install=lambda c: c.with_laws(force=Proportional()))
    assert_same(ours, theirs, 0.0)
    assert [law.calls for law in made] == [20, 1, 20, 1], "every controller has its own"
    with raises(AssertionError):
        assert_same(ours, osc.run(plain), 1e-6)


def test_a_scenario_from_a_dict_is_that_of_the_file():
    loaded = osc.load_scenario("two_contact_rod")
    data = loaded.as_dict() | {"duration": "10 s"}
    data["object"]["pose"]["xyz"] = np.array(data["object"]["pose"]["xyz"])
    assert osc.Scenario.from_dict(data) == loaded
    assert loaded.replaced() == loaded and loaded.replaced().source == loaded.source
    assert loaded.replaced(duration=2.0).duration == 2.0


@mark.parametrize(
    "parts, words",
    [
        ({"duration": -1.0}, "duration: must be > 0"),
        ({"gains": {"motion": {"stiffness": 1, "frequency": 2}}}, "frequency beside stiffness"),
        ({"durations": 1.0}, "did you mean 'duration'"),
        ({"force": {"middle": [{"type": "constant", "value": 1}]}}, "middle"),
        ({"laws": "proportional"}, "expected osc.Laws"),
        ({"contacts": [{"pair": "cone", "body": "groove"}]}, "the key 'type' is missing"),
        ({"contacts": [{"pair": osc.Free(), "body": "table"}], "force": {}}, "environment"),
    ],
)
def test_what_does_not_fit_is_told_as_for_a_file(parts, words):
    with scenario_error(words):
        osc.load_scenario("two_contact_rod").replaced(**parts)

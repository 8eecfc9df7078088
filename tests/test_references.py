"""References: twists and accelerations are the derivatives of the pose, steps and standoffs too."""

import numpy as np
import pinocchio as pin
from complaints import scenario_error
from numpy.linalg import norm
from numpy.testing import assert_allclose
from pytest import approx, mark
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.runs.references import References, common_tangent, force_steps


def references(*overrides):
    rig = rig_of("two_contact_rod_mismatch", *overrides)
    return rig.references


CENTRES = [0.3, -0.2, 0.1], [-0.1, 0.4, 0.5]  # of two turns


def two_turns(centres=(None, None)):
    """Two angular moves about different directions, and a standoff that turns the rod."""
    from osc_contact.scenarios.schema import Scenario

    data = osc.load_scenario("two_contact_rod_mismatch").as_dict()
    sine = {"type": "sine", "amplitude": 0.3, "frequency": 0.7, "phase": 0.4}
    data["motion"] = [
        {"kind": "angular", "direction": [0, 0, 1], "signals": [sine], "through": centres[0]},
        {
            "kind": "angular",
            "direction": [0, 1, 0],
            "signals": [{**sine, "frequency": 1.1}],
            "through": centres[1],
        },
        {"kind": "linear", "direction": [1, 0, 0], "signals": [{**sine, "amplitude": 0.1}]},
    ]
    scenario = Scenario.model_validate(data)
    X = pin.SE3(pin.rpy.rpyToMatrix(0.1, 0.2, 0.3), np.array([0.1, 0.2, 0.3]))
    pairs = rig_of().pairs
    return References.of(scenario, X, pairs, np.array([0.01, 0.0, 0.02, 0.1, -0.2, 0.05]))


@mark.parametrize("centres", [(None, None), CENTRES])
@mark.parametrize("t", [0.2, 0.45, 0.55, 1.3, 2.7])
def test_twist_and_classical_acceleration_are_derivatives_of_the_pose(t, centres):
    wanted = two_turns(centres)
    h = 1e-5
    here = wanted.at(t)
    left = wanted.at(t - h).X_WD
    right = wanted.at(t + h).X_WD
    v = (right.translation - left.translation) / (2 * h)
    w = pin.log3(right.rotation @ left.rotation.T) / (2 * h)
    assert_allclose(here.V_D, np.concatenate((v, w)), atol=1e-7)
    rate = (wanted.at(t + h).V_D - wanted.at(t - h).V_D) / (2 * h)
    assert_allclose(here.A_D, rate, atol=1e-6)


def test_turns_about_points_are_products_of_poses():
    wanted = two_turns(CENTRES)
    t = 2.7  # after the standoff
    angles = [move.signals[0].at(t)[0] for move in wanted.scenario.motion[:2]]
    X = wanted.X_start
    for centre, axis, angle in zip(CENTRES, np.eye(3)[[2, 1]], angles, strict=True):
        to = pin.SE3(np.eye(3), np.array(centre))
        X = to * pin.SE3(pin.exp3(angle * axis), np.zeros(3)) * to.inverse() * X
    X.translation += [wanted.scenario.motion[2].signals[0].at(t)[0], 0, 0]
    assert_allclose(wanted.at(t).X_WD.homogeneous, X.homogeneous, atol=1e-12)
    assert norm(X.translation - wanted.X_start.translation) > 0.02


@mark.parametrize("life, after", [("off", 0.0), ("{}", 0.2)])
def test_the_run_begins_at_the_standoff_and_ends_it_when_it_engages(life, after):
    """Or 0.2 s later, while contacts are approached."""
    wanted = references(f"control.life={life}")
    start = wanted.at(0.0).X_WD
    engaged = wanted.at(wanted.engage_at + after).X_WD
    assert wanted.engage_at == approx(0.6 - after)
    gap = norm(start.translation - wanted.X_start.translation)
    assert gap > 3e-3
    assert_allclose(engaged.translation, wanted.X_start.translation, atol=1e-12)


def test_common_tangent_lies_in_every_face_and_must_be_unique():
    rig = rig_of()
    pairs = rig.pairs
    X = rig.state().X_WO
    u = common_tangent(pairs, X)
    assert norm(u) == approx(1.0)
    for pair in pairs:
        assert abs(u @ pair.normal) < 1e-12
    with scenario_error("span 1"):
        common_tangent(pairs[:1], X)


def test_force_steps_are_found():
    assert force_steps(osc.load_scenario("two_contact_rod")) == [5.0]

"""The plant in Drake without Drake: keys that it refuses, the rule of SAP, the missing package.

`tests/try_drake.py` tests it with Drake, in the environment of `make worlds`.
"""

import sys

import numpy as np
from complaints import plant_error, scenario_error
from pytest import approx
from samples import parametrize

import osc_contact as osc
from osc_contact.lab.rig.landings import landings
from osc_contact.lab.scenarios.hardware import DrakeSpec


def drake_of(*changes, name="two_contact_rod"):
    return osc.load_scenario(name, ["plant.type=drake", "plant.step=1 ms", *changes])


@parametrize(
    "change, named",
    [
        ("plant.joint_friction=0.01", "plant.joint_friction=0.01: the drake plant has ideal"),
        ("plant.motors={bias: 0.01}", "plant.motors={bias: 0.01}: the drake plant has ideal"),
        (
            "plant.flexible_joints={frequency: 5 Hz}",
            "plant.flexible_joints=.*: the drake plant has ideal",
        ),
        ("plant.solref=[0.02, 1]", "plant.solref=.*: softness of MuJoCo's contacts"),
        ("plant.solimp=[0.3, 0.9, 0.001]", "plant.solimp=.*: softness of MuJoCo's contacts"),
        ("plant.drake.contact=tamsi", "Drake's tamsi knows no constraints, and 2 arms"),
    ],
)
def test_what_the_drake_plant_does_not_model_is_refused_by_its_key(change, named):
    with scenario_error(named):
        drake_of(change)


def test_drake_is_missed_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pydrake", None)
    rig = osc.build_rig(drake_of())
    with plant_error(r"pydrake is not installed: pip install 'osc-contact\[drake\]'"):
        rig.plant()


def test_a_moving_face_is_refused_by_the_drake_plant():
    rig = osc.build_rig(drake_of(name="approach_and_slide"))
    with scenario_error("'face_right_end' has a motion, and the bodies of the drake plant are at"):
        rig.plant()


def test_sap_is_refused_where_it_lifts_a_sliding_body_off_its_contact(monkeypatch):
    """(τ₁ + τ₂ + δt) μ v against F/k: 0.157 m/s and μ 0.2 lift by 6 mm, 10 N press 0.1 mm."""
    monkeypatch.setitem(sys.modules, "pydrake", None)  # the rule is checked before Drake is needed
    sap = ("plant.drake.contact=sap", "plant.friction=0.2")
    with scenario_error(r"sap lifts a sliding body .* = 6\.\d+ mm, .* is only 0\.1 mm deep"):
        osc.build_rig(drake_of(*sap)).plant()
    for change in ("plant.friction=0", "plant.drake.contact=lagged"):
        with plant_error("not installed"):
            osc.build_rig(drake_of(*sap, change)).plant()
    still = ("plant.drake.relaxation=0 s", "plant.drake.stiffness=1e4")
    with plant_error("not installed"):
        osc.build_rig(drake_of(*sap, *still)).plant()


def test_similar_is_refused_where_it_lifts_a_sliding_body_off_its_contact(monkeypatch):
    """δt μ v against F/(k (1 + c μ v)): 0.157 m/s and μ 0.2, 0.25 ms, lift by 8 µm."""
    monkeypatch.setitem(sys.modules, "pydrake", None)  # the rule is checked before Drake is needed
    similar = ("plant.drake.contact=similar", "plant.friction=0.2", "plant.step=0.25 ms")
    with plant_error("not installed"):
        osc.build_rig(drake_of(*similar)).plant()
    stiff = "plant.drake.stiffness=2e6"
    with scenario_error(r"similar lifts .* = 0\.0078\d mm, .* is only 0\.0038 mm deep.*step, or"):
        osc.build_rig(drake_of(*similar, stiff)).plant()
    with plant_error("not installed"):
        osc.build_rig(drake_of(*similar, stiff, "plant.step=0.05 ms")).plant()


@parametrize("contact", ["similar", "sap"])
def test_the_largest_friction_of_drake_lifts_by_the_depth(contact):
    spec = DrakeSpec.model_validate({"contact": contact, "relaxation": "1 ms"})
    friction = spec.largest_friction(10.0, 3e5, 0.3, 5e-4)
    assert spec.lift(friction, 0.3, 5e-4) == approx(spec.depth(10.0, 3e5, friction, 0.3))
    assert spec.largest_friction(10.0, 3e5, 0.0, 5e-4) == np.inf  # at rest
    assert spec.largest_friction(0.0, 3e5, 0.3, 5e-4) == 0.0


def test_landings_are_expected_with_the_stiffness_of_the_drake_plant():
    """v √(k m) of Drake's k, where MuJoCo's is proportional to the mass."""
    changes = ("control.in_contact=false", "control.life={}", "plant.drake.stiffness=2e5")
    for landing in landings(osc.build_rig(drake_of(*changes))):
        assert landing.stiffness == 2e5
        assert landing.peak == approx(
            max(landing.command, landing.speed * np.sqrt(2e5 * landing.mass))
        )

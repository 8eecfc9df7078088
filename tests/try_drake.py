"""`make worlds`: the plant in Drake, on the installed Drake.

Not collected by `make test`, whose environment has no Drake; `test_drake_refusals.py` is.
"""

import re
from pathlib import Path

import numpy as np
from pytest import approx, mark, raises

import osc_contact as osc
from benchmarks.gliding import FRICTION, LOAD, SPEED, slide
from benchmarks.two_judges import OPEN_CHAINS, SCENARIOS, changes, judged
from osc_contact.lab.rig import rig as rigs
from osc_contact.lab.scenarios.hardware import DrakeSpec

PAGE = Path(__file__).parent.parent / "docs" / "drake.md"
SECONDS = 2.5


def rig_in(judge, name, *further, friction=0.0):
    return osc.build_rig(osc.load_scenario(name, [*changes(judge, friction), *further]))


def test_the_program_of_the_page_prints_what_is_shown(capsys):
    program, shown = re.search(
        r"```python\n(.*?)```\n\n```text\n(.*?)```", PAGE.read_text(), re.DOTALL
    ).groups()
    exec(compile(program, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == shown


@mark.parametrize("name", SCENARIOS)
def test_both_judges_begin_with_the_same_bodies_in_the_same_places(name):
    """Poses of object and tips, and the total mass, of which each reads the URDFs by itself."""
    mujoco, drake = (rig_in(judge, name).plant() for judge in ("mujoco", "lagged"))
    assert drake.poses() == approx(mujoco.poses(), abs=1e-9)
    assert drake.measure().q == approx(mujoco.measure().q, abs=1e-12)
    mass = sum(body.default_mass() for body in bodies_of(drake))
    in_mujoco = sum(
        mujoco.model.body(b).mass[0]
        for b in range(1, mujoco.model.nbody)
        if not mujoco.model.body(b).name.startswith("face")
    )
    assert mass == approx(in_mujoco, rel=1e-9)


def bodies_of(plant):
    """Drake's bodies of arms and object."""
    names = [*(arm.name for arm in plant.chain.arms), "object"]
    model = plant.scene.plant
    instances = [model.GetModelInstanceByName(name) for name in names]
    return [model.get_body(i) for one in instances for i in model.GetBodyIndices(one)]


@mark.parametrize("friction", [0.0, 0.2])
@mark.parametrize("name", SCENARIOS)
def test_forces_and_path_hold_before_drake_too(name, friction):
    verdict = judged(name, friction, "lagged", duration=SECONDS)
    assert verdict.is_within, verdict
    assert verdict.closed == 1.0 and verdict.status == "OK"


@mark.parametrize("name", OPEN_CHAINS)
def test_forces_hold_under_tamsi_where_no_loop_is_closed(name):
    verdict = judged(name, 0.2, "tamsi", duration=SECONDS)
    assert verdict.is_within and verdict.closed == 1.0, verdict


@mark.parametrize("name", ["panda_edge", "ur5_wipe", "dual_panda_rod"])
def test_wrists_read_the_force_of_the_contacts(name):
    """Without friction: sign, point and axes of the reactions are those of a wrist sensor."""
    recording = osc.run(osc.load_scenario(name, changes("lagged")), duration=1.2)
    error = recording["alpha_meas"][500:] - recording["alpha_true"][500:]
    assert np.abs(error).max() < 0.2


def test_the_rule_of_sap_tells_which_contacts_open_by_themselves(monkeypatch):
    sap = ("plant.drake.contact=sap", "plant.friction=0.2")
    monkeypatch.setattr(rigs, "require_closed_slip", lambda *given: None)
    shares = []
    for further in ((), ("plant.drake.relaxation=0 s", "plant.drake.stiffness=1e4")):
        scenario = osc.load_scenario("panda_edge", [*changes("lagged"), *sap, *further])
        recording = osc.run(scenario, duration=1.5)
        shares.append(recording["closed"][500:].mean())
    assert shares[0] < 0.8 and shares[1] == 1.0, shares


@mark.parametrize("contact", ["lagged", "similar", "sap"])
def test_a_sliding_ball_is_as_deep_as_the_rule_expects(contact):
    spec = DrakeSpec.model_validate({"contact": contact, "relaxation": 0.0})
    slid = slide(spec, 5e-4)
    expected = spec.depth(LOAD, 1e5, FRICTION, SPEED) - spec.lift(FRICTION, SPEED, 5e-4)
    assert slid.depths == approx(expected, rel=2e-3) and slid.forces == approx(LOAD, rel=1e-3)


def test_similar_opens_a_contact_where_the_rule_says_so():
    stiff = DrakeSpec.model_validate({"contact": "similar", "stiffness": 3e5})
    assert stiff.largest_friction(LOAD, 3e5, SPEED, 5e-4) < FRICTION
    assert np.mean(slide(stiff, 5e-4).forces > 0.0) < 0.8
    assert np.mean(slide(stiff, 1e-4).forces > 0.0) == 1.0


@mark.parametrize(
    "change, named",
    [
        ("arms.panda.wrist_sensor=panda_link7", "reads wrists at fixed joints.*panda_link7"),
        ("arms.panda.friction=[1]", "arms.friction: joint panda/panda_joint1 has a dry friction"),
    ],
)
def test_what_the_plant_does_not_model_is_refused_by_name(change, named):
    rig = rig_in("lagged", "panda_edge", change)
    with raises(osc.PlantError, match=named):
        rig.plant()

"""What the runs of a sweep share: every number of a recording is that of the run by itself."""

from pytest import raises
from scenario_runs import assert_same_run, rig_of

import osc_contact as osc
from osc_contact import robots
from osc_contact.contacts.detection import collision_shapes
from osc_contact.recorder.journal import MemoryJournal
from osc_contact.runs.preflight import require_ready
from osc_contact.runs.run import run_rig, start
from osc_contact.sweeps.rows import Workshop


def compare(one, other):
    assert_same_run(one, other)
    clocks = {"wall_s": 0.0, "cpu_s": 0.0}
    assert one.meta | clocks == other.meta | clocks


def test_rigs_of_a_workshop_are_those_built_alone():
    """In an order in which every chain that is kept has been used by another run."""
    workshop = Workshop()
    scenarios = [
        osc.load_scenario(
            "two_contact_rod",
            {
                "model_error.object_mass": mass,
                "contacts.left_end.face.normal.0": normal,
                "duration": "0.05 s",
            },
        )
        for mass in ("1.0", "1.2")
        for normal in ("0.50", "0.53")
    ]
    for scenario in scenarios:
        compare(osc.run(scenario), run_rig(workshop.rig(scenario), journal=MemoryJournal()))
    rigs = [workshop.rig(scenario) for scenario in scenarios]
    assert len({id(rig.chain) for rig in rigs}) == 1 and len({id(rig.model) for rig in rigs}) == 2
    assert len({rig.q_contact.tobytes() for rig in rigs}) == 2  # the normals do vary


def test_files_that_changed_are_read_anew_and_what_is_returned_is_nobodys(tmp_path):
    """What was read is kept by its bytes: same length, same second, another robot."""
    file = tmp_path / "body.urdf"
    text = robots.urdf_path("rod").read_text()
    heavier = text.replace('<mass value="1.5"/>', '<mass value="2.5"/>')
    assert len(heavier) == len(text) and heavier != text
    masses = []
    for one in (text, heavier, text):
        file.write_text(one)
        masses.append(robots.load_body(file).mass)
        robots.load_body(file).mass = 99.0
    assert masses[0] == masses[2] == 1.5 and masses[1] == 2.5
    arm = robots.load_model(robots.urdf_path("scara_left"))
    arm.armature = arm.armature + 5.0
    assert not robots.load_model(robots.urdf_path("scara_left")).armature.any()
    (shape, *_) = collision_shapes(file)
    n = len(collision_shapes(file))
    file.write_text(text.replace("<sphere radius", "<sphere  radius").replace("0.01", "0.02"))
    assert len(collision_shapes(file)) == n and collision_shapes(file)[0] is not shape


def test_doubts_and_refusals_are_those_of_a_run():
    scenario = osc.load_scenario("two_contact_rod", ["duration=0.05 s", "control.rate=80 Hz"])
    rig = osc.build_rig(scenario)
    assert require_ready(rig) == run_rig(rig).meta["doubts"] != []
    with raises(osc.ScenarioError):
        run_rig(osc.build_rig(scenario.replaced(control={"rate": 20.0})))


def test_start_leaves_the_controller_that_only_gave_first_torques_behind():
    """Both controllers of a start know nothing of one another."""
    rig = rig_of()
    _, controller = start(rig)
    assert not controller._records.memory.ticked

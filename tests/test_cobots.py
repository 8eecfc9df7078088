"""Random tasks with everything wrong at once: they are drawn, run, judged and kept as said."""

from dataclasses import replace

import numpy as np
from pytest import approx, mark
from samples import first, parametrize

import osc_contact as osc
from benchmarks.cobots import Kept, Outcome, judge, summary, window_error
from benchmarks.random_tasks import GROUPS, PACKAGED, TIPS, draw

pytestmark = mark.usefixtures("own_plants")  # each task enters its plant

FINE = Outcome(0, 0, "", "panda", {}, [], [], "OK", "", False, 0.01)


def test_a_task_is_the_same_for_the_same_numbers_and_another_one_for_others():
    one, same, other = draw(3, 5), draw(3, 5), draw(3, 6)
    assert one == same
    assert one.scenario != other.scenario or one.wrong != other.wrong
    names = {draw(3, number).name for number in range(12)}
    assert names <= {*TIPS, *PACKAGED} and len(names) > 3


def test_all_that_is_wrong_reaches_the_scenario_and_the_plant_and_can_be_left_out():
    number = next(k for k in range(100) if set(draw(0, k).wrong) == set(GROUPS))
    task = draw(0, number)
    scenario = task.load()
    assert scenario.plant.flexible_joints and scenario.plant.motors and scenario.plant.friction
    assert scenario.sensors.encoder and scenario.sensors.wrist and scenario.tare
    assert scenario.model_error.face_tilt and scenario.model_error.hidden_mass
    rig = osc.build_rig(scenario)
    plant = rig.plant()
    lean = plant.plant.model.opt.gravity[:2]
    assert 0.0 < np.linalg.norm(lean) < 9.81 * np.radians(0.5)
    assert plant.measure().touched is None
    for group in GROUPS:
        left = task.without(group)
        assert set(left.wrong) == set(GROUPS) - {group}
        assert left.load() != scenario
    plant = osc.build_rig(task.without("masses").load()).plant()
    assert not plant.plant.model.opt.gravity[:2].any()


@parametrize("number", first([2, 0], 1))
def test_a_task_runs_to_its_end_and_is_judged(number):
    """The task of seed 1 has a Kinova and a Z1 on elastic walls."""
    found = judge(1, number)
    assert found.word == "OK" and not found.noticed and not found.wrong_ok
    assert 0.0 < found.rms < 0.05
    assert found.rms <= found.window and 1.0 < found.landing < 1.5


def test_what_a_verdict_does_not_say_is_named():
    assert FINE.wanted and not FINE.wrong_ok
    for change in ({"window": 0.11}, {"peak": 2.1}, {"opened": 0.011}, {"off": 0.0051}):
        wrong = replace(FINE, **change)
        assert wrong.wrong_ok and not wrong.wanted
        assert not replace(wrong, failed=True).wrong_ok
    assert not replace(FINE, rms=0.051).wanted


def test_the_largest_error_within_a_second_is_of_judged_ticks():
    error = np.zeros(3000)
    error[1000:2000] = 0.3
    judged = np.ones(3000, dtype=bool)
    assert window_error(error, judged, 1000.0) == approx(0.3)
    judged[1200:] = False
    error[1200:] = 0.0
    assert window_error(error, judged, 1000.0) == approx(0.3 * np.sqrt(200 / 501), rel=0.05)


def test_outcomes_are_kept_and_summed_up(tmp_path):
    kept = Kept(tmp_path)
    noticed = replace(FINE, number=1, doubted=["it"])
    kept.add(FINE)
    kept.add(noticed)
    (file,) = tmp_path.iterdir()
    with file.open("a") as cut:
        cut.write('{"seed": 1')
    again = Kept(tmp_path)
    assert again.outcomes([(0, 0, ""), (0, 1, "")], 1) == [FINE, noticed]
    found = summary([FINE, noticed, replace(FINE, failed=True, rms=0.5)])
    assert found["doubted"] == 1 and found["of these below 5 % all the same"] == 1
    assert found["others"] == 2 and found["failed"] == 1

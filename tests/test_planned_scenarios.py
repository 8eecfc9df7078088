"""Plans in scenarios: keys with the words of Python, refusals, checks, runs and verdicts."""

import pickle
from copy import deepcopy

import numpy as np
from complaints import scenario_error
from pytest import approx, fixture
from samples import parametrize

import osc_contact as osc
from osc_contact.lab.checks.inspection import inspect_rig
from osc_contact.lab.reports.report import verdict_table
from osc_contact.lab.reports.web_page import write_web_page
from osc_contact.lab.runs.tape import build
from osc_contact.lab.scenarios.plan_keys import CONDITIONS, MOTIONS, PlanKeys
from osc_contact.plan import ends, motions

EDGE = osc.load_scenario("panda_edge")
PRESS = {
    "name": "press",
    "forces": {"edge": "10 N"},
    "until": {"after": "300 ms"},
    "within": "1 s",
}
SLIDE = {
    "name": "slide",
    "forces": {"edge": 10.0},
    "motion": {"along": {"direction": [0, 2, 0], "speed": "10 mm/s", "distance": "8 mm"}},
    "until": "finished",
    "unless": {"lost": "edge"},
    "within": "2 s",
}


def with_plan(*stages, **keys):
    """Scenario of the edge whose forces and motions are those of a plan."""
    data = EDGE.as_dict()
    for key in ("force", "motion"):
        data.pop(key)
    plan = {"largest": "60 N", "stages": deepcopy(list(stages))}
    return osc.Scenario.from_dict(data | {"plan": plan, "duration": "3 s"} | keys, EDGE.source)


@fixture(scope="module")
def recording():
    return osc.run(with_plan(PRESS, SLIDE))


def test_keys_are_those_of_the_functions():
    """Each in its own words; a value alone is the first argument, a name alone has none."""
    stage = SLIDE | {
        "forces": {"edge": "1 N", "pad": ["2 N", "3 N"]},
        "motion": [
            {"turn_to": {"axis": [0, 0, 1], "direction": [0, 0, -1], "rate": "0.1 rad/s"}},
            {"along": {"direction": [0, 0, -1], "speed": "5 mm/s", "yields": "6 N"}},
        ],
        "until": {
            "any": [
                {"all": [{"made": ["edge", "pad"]}, "at_rest"], "lasting": "0.3 s"},
                {"moved": {"distance": "3 mm", "point": [0, 0, "10 mm"]}},
            ]
        },
        "largest": "40 N",
    }
    (made,) = PlanKeys(stages=[stage]).made().stages
    turn = motions.turn_to([0, 0, 1], [0, 0, -1], 0.1)
    resting = (ends.made("edge", "pad") & ends.at_rest()).lasting(0.3)
    assert made.forces == {"edge": 1.0, "pad": (2.0, 3.0)}
    assert made.motion.words == (turn & motions.along([0, 0, -1], 5e-3, yields=6.0)).words
    assert made.until.words == (resting | ends.moved(3e-3, point=[0, 0, 0.01])).words
    assert made.until.contacts == ("edge", "pad")
    assert made.unless.words == ends.lost("edge").words
    assert (made.within, made.largest) == (2.0, 40.0)


def test_every_function_has_keys():
    (stage,) = PlanKeys(stages=[SLIDE]).stages
    for functions, keys in ((MOTIONS, stage.motion[0]), (CONDITIONS, stage.until)):
        assert {function.__name__ for function in functions} <= set(type(keys).model_fields)


def test_a_planned_scenario_is_data():
    scenario = with_plan(PRESS, SLIDE)
    assert osc.Scenario.from_dict(scenario.as_dict(), EDGE.source) == scenario
    assert pickle.loads(pickle.dumps(scenario)) == scenario
    assert scenario.plan.made().stages[0].largest == np.inf


def changed(stage, **keys):
    """Stage with other keys."""
    return deepcopy(stage) | keys


ALONG = {"direction": [0, 1, 0], "speed": "1 mm/s"}


@parametrize(
    "words, stages",
    {
        "forces.edg: no contact has this name; did you mean 'edge'": [
            changed(PRESS, forces={"edg": "10 N"})
        ],
        "until.after.seconds: expected a time in s.*got '2 mm', which is a length": [
            changed(PRESS, until={"after": "2 mm"})
        ],
        "until.afterr: unknown key; did you mean 'after'": [changed(PRESS, until={"afterr": 1})],
        "expected one of made.* got made and after": [
            changed(PRESS, until={"after": "1 s", "made": "edge"})
        ],
        "along.sped: unknown key; did you mean 'speed'": [
            changed(PRESS, motion={"along": ALONG | {"sped": 1}})
        ],
        "along: speed = -0.001; give a number > 0": [
            changed(PRESS, motion={"along": ALONG | {"speed": "-1 mm/s"}})
        ],
        "the key 'within' is missing: time after which the stage has failed": [
            {key: PRESS[key] for key in PRESS if key != "within"}
        ],
        "stage 'press': fails='pres' does not exist; did you mean 'press'": [
            changed(PRESS, fails="pres")
        ],
        "several stages are named 'press'": [PRESS, PRESS],
        "expected at least 1 items": [],
    },
)
def test_refusals_name_the_key_and_the_cure(words, stages):
    with scenario_error(words):
        with_plan(*stages)


@parametrize("key", ["force", "motion", "squeeze"])
def test_a_plan_replaces_forces_and_motions(key):
    beside = {"force": EDGE.as_dict()["force"], "motion": EDGE.as_dict()["motion"], "squeeze": 3.0}
    with scenario_error(f"{key}: the stages of the plan have their own; leave it out"):
        with_plan(PRESS, **{key: beside[key]})


def test_a_motion_that_contacts_block_is_refused_before_the_run():
    blocked = {"along": {"direction": [0.6, 0, -0.8], "speed": "10 mm/s"}}
    with scenario_error("plan: stage 'slide': edge permit no velocity of along"):
        osc.run(with_plan(PRESS, changed(SLIDE, motion=blocked)))


def test_inspect_draws_the_stages():
    lines = inspect_rig(osc.build_rig(with_plan(PRESS, SLIDE))).lines
    stages = [line for line in lines if line.startswith("stage")]
    assert stages == [
        "stage 'press': 'edge' 10 N (r = 1, 5 motions free), dwell; ends by: after 0.3 s → slide; "
        "fails after 1 s → end, failed.",
        "stage 'slide': 'edge' 10 N (r = 1, 5 motions free), along [0, 1, 0] at 10 mm/s; ends by: "
        "motion finished → end; fails after 2 s, or by: edge lost → end, failed.",
    ]


def test_a_run_follows_its_plan_and_ends_with_it(recording):
    verdict = osc.metrics(recording)
    assert verdict["task"]["word"] == "OK", verdict["task"]
    plan = verdict["plan"]
    assert (plan["outcome"], plan["reason"]) == ("done", "")
    press, slide = plan["stages"]
    assert press["ended_by"] == "after 0.3 s" and slide["ended_by"] == "motion finished"
    assert press["duration"] == approx(0.3, abs=2e-3)
    assert len(recording) == approx(1e3 * (press["duration"] + slide["duration"]), abs=3)
    way = recording["pose"][-1][:3] - recording["pose"][0][:3]
    assert way[1] == approx(8e-3, abs=2e-4)
    rows = dict(zip(*(column.cells for column in verdict_table(verdict).columns), strict=True))
    assert rows["stage slide"].endswith("motion finished")


def test_a_plan_that_is_not_done_fails_the_run():
    slow = changed(SLIDE, until={"moved": "50 mm"}, within="0.9 s")
    task = osc.metrics(osc.run(with_plan(PRESS, slow)))["task"]
    assert (task["word"], task["failed"]) == ("NOT DONE", True)
    assert "the plan is failed: stage 'slide': 0.9 s without: moved by 50 mm" in task["why"][0]


@parametrize(
    "words, call",
    {
        "a recording to replay in C": lambda scenario, folder: build(
            osc.build_rig(scenario), folder
        ),
        "a page": lambda scenario, folder: write_web_page(scenario, folder),
    },
)
def test_uses_that_need_all_references_refuse_plans(words, call, tmp_path):
    with scenario_error(f"plan: {words} needs the references of all times"):
        call(with_plan(PRESS), tmp_path)


def test_a_plan_is_aborted_at_the_end_of_the_duration():
    slow = changed(SLIDE, until={"moved": "50 mm"}, within="9 s")
    recording = osc.run(with_plan(PRESS, slow, duration="1.4 s"))
    task = osc.metrics(recording)["task"]
    assert task["word"] == "NOT DONE"
    assert "the plan is aborted: duration = 1.4 s is over; give a longer one" in task["why"][0]
    assert len(recording) == approx(1400, abs=101)

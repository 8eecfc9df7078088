"""Robustness study: all laws meet the same plants, and do not know what varies."""

import numpy as np
from command_line import done, read_json, refused
from complaints import invalid_input
from pytest import MonkeyPatch, approx, mark
from rigs import assert_near
from samples import aligned, module_fixture, names_in
from scenario_runs import rig_of, verdict_of

import osc_contact as osc
from osc_contact.lab.sweeps import sweep
from osc_contact.lab.sweeps.study import SweepStudy
from paper import robustness as study
from paper.selection_laws import Selection

#: Of wrong masses and friction `preflight` has notes.
WORDS = {"masses": "DOUBTFUL", "friction": "DOUBTFUL", "delay": "OK", "normals": "OK"}
CHANGES = ["control.rate=250 Hz", "plant.step=0.5 ms", "duration=1.1", "verdict.force_rms=0.9"]


@module_fixture
def made(tmp_path_factory):
    """Two samples of each case, by command: (folder, what it printed)."""
    folder = tmp_path_factory.mktemp("robustness")
    line = f"reproduce robustness --samples 2 --duration 1.1 --out {folder}"
    with MonkeyPatch.context() as patch:
        patch.setattr(study, "_FIRST", 0)  # the best law from nominal runs alone
        printed = done(line).stdout
        assert "another study" in refused(f"{line} --seed 1")
    return (folder, printed)


def assert_row_is_that_of_single_runs(row, case, number, laws):
    points = SweepStudy.of("two_contact_rod", study.VARIED[case], 2, overrides=CHANGES)
    drawn = points.sample(number)
    changes = [*CHANGES, *(f"{k}={v}" for k, v in drawn.overrides.items())]
    scenario = osc.load_scenario("two_contact_rod", changes)
    for name, law in laws.items():
        force, motion = errors(scenario, drawn.seed, install=law.install)
        assert row[f"{name}.force"] == approx(force, rel=1e-6)
        assert row[f"{name}.motion"] == approx(motion, rel=1e-6)
        assert row[f"{name}.word"] == WORDS[case] and not row[f"{name}.failed"]


@module_fixture
def found(made):
    return read_json(made[0] / "robustness.json")


def errors(scenario, seed, **how):
    verdict = verdict_of(scenario, seed=seed, **how)
    errors = [one["rms_error_rel"] for one in verdict["force"].values()]
    force = max(np.inf if error is None else error for error in errors)  # None: never in contact
    return (force, verdict["motion"]["rms_error_m"])


@mark.slow
def test_rows_are_single_runs_of_the_same_sample_under_each_law(found):
    rig = rig_of("two_contact_rod", *CHANGES)
    laws = {"ours": study.Ours()} | {name: chosen_law(rig, name) for name in study.BASELINES}
    for case in study.VARIED:
        assert_row_is_that_of_single_runs(found["rows"][case][1], case, 1, laws)


def chosen_law(rig, family):
    """A family's best law, by its definition: least product of both errors in the nominal run."""
    laws = study.best_frames(study.Instant(rig.state, rig.contact), study.BASELINES[family])
    candidates = [(law, *errors(rig.scenario, 0, install=law.install)) for law in laws]
    return min(candidates, key=lambda one: one[1] * one[2])[0]


def test_rows_are_those_of_single_runs_and_are_not_run_again(tmp_path, monkeypatch):
    counts = []
    inner = sweep.make_all

    def make_all(crew, jobs, make):
        counts.append(len(jobs))
        return inner(crew, jobs, make)

    def candidates(_, family, __):
        return [(study.SelectionLaw(family, chosen[0]), 1.0)]

    monkeypatch.setattr(sweep, "make_all", make_all)
    monkeypatch.setattr(study, "_candidates", candidates)
    axes = (np.zeros(3), [np.eye(3)])
    chosen = [Selection.of_axes(*axes, (1, 3)), Selection.of_axes(*axes, (1, 5))]
    ask = study.Ask(changes=CHANGES, samples=1, folder=tmp_path)
    first = study.run(ask, 1)
    second = study.run(ask, 1)
    assert counts == [1] * 4 + [0] * 4 and first["rows"] == second["rows"]
    assert_row_is_that_of_single_runs(first["rows"]["delay"][0], "delay", 0, {"ours": study.Ours()})
    del chosen[0]
    with invalid_input("seed or law"):  # rows of other laws
        study.run(ask, 1)


@mark.slow
def test_what_the_controllers_do_not_know_costs_all_of_them_accuracy(found):
    for case in ("masses", "friction", "normals"):
        for law in study.LAWS:
            worst = max(row[f"{law}.force"] for row in found["rows"][case])
            assert worst > found["nominal"][f"{law}.force"] + 0.01  # of the command


@mark.slow
def test_the_table_shows_the_rows(made, found):
    folder, printed = made
    assert names_in(folder) == {
        "robustness.json",
        *(f"robustness_{case}.jsonl" for case in study.VARIED),
    }
    for case, title in study.TITLES.items():
        known = found["cases"][case]
        assert title in printed and known["samples"] == 2
        for law in study.LAWS:
            assert known[law]["success_rate"] == 1.0
            worst = 1e3 * max(row[f"{law}.motion"] for row in found["rows"][case])
            assert known[law]["motion"][-1] == approx(worst) and f"{worst:.3g}" in printed
    assert {one["candidates"] > 4 for one in found["selection"].values()} == {True}
    assert all(label in printed for label in study.LABELS.values())


def test_failed_runs_count_as_the_largest_errors():
    values = np.random.default_rng(0).uniform(1, 2, 50)
    failed = np.arange(50) < 3
    rows = [
        {"ours.failed": bool(f), "ours.force": None if f else x, "ours.motion": 0.0}
        for x, f in aligned(values, failed)
    ]
    known = study.quantiles(rows, "ours")
    assert known["success_rate"] == approx(0.94)
    expected = np.quantile(np.where(failed, np.inf, values), (0.5, 0.9), method="inverted_cdf")
    assert_near(known["force"][:2], 100 * expected)
    assert known["force"][2] is None

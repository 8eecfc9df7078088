"""Tuning: found values are better in separate runs, limits hold, trials continue."""

import numpy as np
from command_line import answered
from pytest import approx, raises
from samples import aligned, parametrize
from scenario_runs import verdict_of, worst_force

import osc_contact as osc
from osc_contact.lab.sweeps import tune as tuning
from osc_contact.lab.sweeps.tune import tune

SHORT = ("duration=1.1 s",)
ONE = {"overrides": SHORT, "workers": 1}


def errors(changes):
    """Largest relative force error, position error, largest overshoot of one run."""
    verdict = verdict_of("two_contact_rod", *SHORT, *changes)
    force = worst_force(verdict)
    steps = [step["overshoot_rel"] for step in verdict["steps"]]
    return (force, verdict["motion"]["rms_error_m"], max(steps))


def test_found_gains_beat_the_shipped_ones_in_a_run_of_their_own():
    sudden = "gains.force.rise=0 s"  # or the shipped overshoot is too small for a limit of it
    found = tune("two_contact_rod", overrides=(*SHORT, sudden), trials=14, workers=1, seed=1)
    assert found.better and found.trials == 14
    changes = [f"{k}={v}" for k, v in found.values.items()]
    shipped = errors([sudden])
    best = errors([sudden, *changes])
    assert found.shipped == approx(1.0)
    assert found.best == approx(0.5 * (best[0] / shipped[0] + best[1] / shipped[1]))
    assert found.best < 0.9
    assert shipped[2] > 0.05 and best[2] <= 1.05 * shipped[2] + 1e-12
    assert found.numbers["overshoot_rel"] == approx((shipped[2], best[2]))
    assert set(found.values) == {one.partition("=")[0] for one in tuning.GAINS[:4]}


def test_what_is_not_known_counts_by_its_mean_and_limits_by_the_worst(monkeypatch):
    seen = []
    inner = tuning.make_rows

    def make_rows(study, numbers):
        rows = inner(study, numbers)
        seen.extend(rows)
        return rows

    monkeypatch.setattr(tuning, "make_rows", make_rows)
    found = tune(
        "two_contact_rod",
        ["gains.force.integral=uniform(10, 60)"],
        objective="force",
        over=["model_error.object_mass=uniform(0.9, 1.1)"],
        samples=2,
        overrides=SHORT,
        trials=3,
        workers=1,
    )
    force = [
        [max(r["force.left_end.rms_error_rel"], r["force.right_end.rms_error_rel"]) for r in rows]
        for rows in aligned(seen[::2], seen[1::2])
    ]
    assert len(force) == 4 and all(len(one) == 2 for one in force)
    assert found.shipped == approx(np.mean(force[0]))
    assert any(found.best == approx(np.mean(one)) for one in force[1:])
    assert found.numbers["force"][0] == approx(max(force[0]))


@parametrize("most, broken", {0.001: ("overshoot_rel > 0.001",), 9.0: ()})
def test_limits_that_no_trial_keeps_are_named(most, broken):
    found = tune("two_contact_rod", limits={"overshoot_rel": most}, trials=3, **ONE)
    assert found.broken == broken and not (broken and found.better)


def test_trials_in_a_folder_are_gone_on_with(tmp_path):
    counts = []
    how = {"out": tmp_path, "progress": lambda done, _: counts.append(done)} | ONE
    first = tune("two_contact_rod", trials=3, **how)
    second = tune("two_contact_rod", trials=5, **how)
    assert counts == [1, 2, 3, 4, 5]
    assert second.trials == 5 and second.best <= first.best


def test_command_prints_the_keys_to_paste():
    key = "gains.motion.stiffness"
    result, found = answered(
        f"tune two_contact_rod --duration 1.1 --trials 5 --workers 1 --vary '{key}=factor(1, 4)' "
        "--objective motion --limit overshoot_rel=2"
    )
    assert found["better"] and f"{key}: {found['values'][key]}" in result.output
    assert found["best"] == approx(errors([f"{key}={found['values'][key]}"])[1])


@parametrize(
    "complaint, how",
    {
        "give force, motion, both, or a column": {"objective": "speed"},
        "no such columns": {"limits": {"speed": 1.0}},
        "judged": {"overrides": ["duration=0.5 s"]},
        "integral": {"overrides": [*SHORT, "gains.force.integral=3000"]},
    },
)
def test_what_cannot_be_tuned_is_refused(how, complaint):
    with raises(osc.OscContactError, match=complaint):
        tune("two_contact_rod", **(ONE | {"trials": 1} | how))

"""The verdict in a word: overshoot, lost contacts, exit codes; contact or not, as it is watched."""

import json

import numpy as np
from command_line import call, read_json
from complaints import invalid_input, refusals
from numpy.testing import assert_array_equal
from pytest import approx
from samples import aligned, parametrize
from scenario_runs import run_of
from test_law_phases import watched

import osc_contact as osc
from osc_contact.control.monitor import ContactMonitor, watch_series
from osc_contact.lab.reports.report import task_lines, verdict_table
from osc_contact.lab.runs.verdict import RULES, Rule, judge_task
from osc_contact.recorder.judged import READ, JudgedTicks
from osc_contact.settings.control import MonitorLimits, VerdictSpec

RATE = 1000
TICKS = 3000


def made(meta=(), **channels):
    """A recording of one contact that follows its command, but for what is given."""
    ones = np.ones((TICKS, 1))
    plain = {
        "t": np.arange(TICKS) / RATE,
        "alpha_cmd": 10 * ones,
        "alpha_true": 10 * ones,
        "alpha_meas": 10 * ones,
        "power_total": np.ones(TICKS),
        "power_projected": np.zeros(TICKS),
        "motion_error": np.zeros((TICKS, 6)),
        "closed": ones.astype(bool),
        "contact_phase": np.full((TICKS, 1), 2),
        "status": np.zeros(TICKS, int),
        "tau": np.zeros((TICKS, 1)),
        "tick_s": np.full(TICKS, 1e-5),
    }
    about = {
        "scenario": {"name": "made"},
        "plant": "mujoco",
        "seed": 0,
        "wall_s": 1.0,
        "force_steps_s": [],
        "control_rate_hz": RATE,
        "contact_names": ["tip"],
        "columns": [0],
        "effort_limits": {"j": 5.0},
        "end_state": "RUN",
        "end_reason": "",
    }
    return osc.Recording(about | dict(meta), plain | channels)


def rows_of(verdict):
    return [str(cell) for column in verdict_table(verdict).columns for cell in column.cells]


def changed(name, start, stop, value):
    """One channel of `made` with another value for some ticks."""
    values = made()[name].copy()
    values[start:stop] = value
    return {name: values}


def test_a_step_is_reported_with_its_overshoot_and_the_first_contact_too():
    command, truth = np.full((2, TICKS, 1), 10.0)
    command[2000:] = truth[2000:] = 4.0
    truth[:40] = 0.0
    truth[40:90] = 13.0
    truth[2100] = 3.4
    truth[2600] = 0.0  # later than the step's window
    closed = np.arange(TICKS)[:, None] >= 40
    verdict = osc.metrics(
        made({"force_steps_s": [2.0]}, alpha_cmd=command, alpha_true=truth, closed=closed)
    )
    assert verdict["first_contact_s"] == {"tip": approx(0.04)}
    keys = ("what", "from_N", "to_N", "peak_N", "overshoot_rel")
    assert [[step[key] for key in keys] for step in verdict["steps"]] == [
        ["first contact", 0.0, 10.0, 13.0, approx(0.3)],
        ["step", 10.0, 4.0, approx(3.4), approx(0.1)],
    ]
    assert verdict["steps"][1]["t_s"] == 2.0
    assert verdict["task"] == {"word": "OK", "failed": False, "why": []}
    rows = "\n".join(rows_of(verdict))
    assert "reaches 13 N of 10 N, overshoot 30 %" in rows
    assert "from 10 N to 4 N; reaches 3.4 N of 4 N, overshoot 10 %" in rows


open_late = changed("closed", 2000, 2500, 0)
resting = changed("contact_phase", 2000, 2500, 0) | changed("alpha_cmd", 2000, 2500, 0.0)
turned = np.array([0, 0, 0, 0.4, 0, 0])
held = changed("status", 1500, 1600, 2) | changed("motion_error", 1500, 1600, np.nan)


@parametrize(
    "row",
    [
        ("LOST!", "open for up to 0.06 s", changed("closed", 2000, 2060, 0)),
        ("OK", "", changed("closed", 2000, 2015, 0)),
        ("POOR!", "open in 2.0% of its judged time", changed("closed", 2000, 2040, 0)),
        ("OK", "", changed("closed", 500, 900, 0)),  # before it is judged
        ("HOPPING", "hopped in 100 of 3000 ticks", changed("status", 2000, 2100, 4)),
        ("LOST!", "never made", changed("closed", 0, TICKS, 0)),
        ("POOR!", "open in 25.0%", open_late | changed("contact_phase", 2000, 2500, 1)),
        ("OK", "", open_late | resting),
        ("LOST!", "never made again", changed("closed", 2000, TICKS, 0) | resting),
        ("RUN AWAY!", "150 mm", changed("motion_error", 2000, 2001, 0.15 / 3**0.5)),
        ("RUN AWAY!", "turned by 0.4 rad", changed("motion_error", 2000, 2001, turned)),
        ("POOR!", "12 N rms", changed("alpha_true", 1000, TICKS, 22.0)),
        (
            "POOR!",
            "9.5 N rms, 95.0% of its mean command 10 N",
            changed("alpha_true", 1000, TICKS, 0.5),
        ),
        ("POOR!", "limit 10.0%", changed("alpha_true", 1000, TICKS, 8.9)),
        ("OK", "", changed("alpha_true", 1000, TICKS, 9.1)),
        ("POOR!", "10.6% of its mean command", changed("alpha_true", 1950, 2450, 8.5)),
        ("OK", "", changed("alpha_true", 1950, 2350, 8.5)),
        ("POOR!", "2.1 times its command", changed("alpha_true", 2000, 2001, 21.0)),
        ("OK", "", changed("alpha_true", 2000, 2001, 19.0)),
        ("POOR!", "6.0 mm off its", changed("motion_error", 2000, 2001, [0.006, 0, 0, 0, 0, 0])),
        ("OK", "", changed("motion_error", 2000, 2001, [0.004, 0, 0, 0, 0, 0])),
        ("DOUBTFUL", "before it ran: no tare", {}, {"doubts": ["no tare"]}),
        ("HELD!", "100 of 3000 ticks", held, {"end_reason": "a cable broke"}),
        ("HELD", "1 of 3000 ticks", changed("status", 1500, 1501, 2)),
        (
            "SATURATED",
            "at a motor limit (j)",
            changed("status", 1500, 1600, 1) | changed("tau", 1500, 1600, 5.0),
        ),
        (
            "STOPPED!",
            "joint 1 too fast",
            {},
            {"end_state": "SAFE_STOP", "end_reason": "joint 1 too fast"},
        ),
    ],
)
def test_each_word_has_its_threshold(row):
    """A word with an exclamation mark is a task that failed."""
    word, sentence, channels, *meta = row
    verdict = osc.metrics(made(*meta, **channels))
    task = verdict["task"]
    assert task["word"] + "!" * task["failed"] == word, task
    assert json.loads(json.dumps(verdict, allow_nan=False)) == verdict
    lines = list(task_lines(verdict))
    assert lines[0] == "verdict: " + word.replace("!", ", the task failed")
    assert sentence in "\n".join(lines)


def test_a_contact_that_is_not_active_is_not_judged():
    """It is not lost, its force is none; active again it is judged."""
    spans = "active.left_end=[[0 s, 1.5 s], [2.5 s, 9 s]]"
    recording = run_of("two_contact_rod", spans, duration=4.0)
    left = recording["alpha_cmd"][:, 0]
    active = recording["contact_phase"][:, 0] != 0
    commanded = left > 0.0
    assert active[commanded].all() and 900 < np.count_nonzero(~commanded) < 1100
    unloading = recording["t"][active & ~commanded]  # still closed, with a force that goes to zero
    rise = osc.load_scenario("two_contact_rod").gains.force.rise
    assert unloading.min() == approx(1.5, abs=2e-3) and np.ptp(unloading) == approx(rise, abs=5e-3)
    task = osc.metrics(recording)["task"]
    assert task["word"] == "OK", task
    never = changed("closed", 0, TICKS, 0) | changed("alpha_cmd", 0, TICKS, 0.0)
    approached = never | changed("contact_phase", 0, TICKS, 1)
    assert osc.metrics(made(**approached))["task"]["word"] == "LOST"
    resting = never | changed("contact_phase", 0, TICKS, 0)
    assert osc.metrics(made(**resting))["task"]["word"] == "OK"


def test_contacts_that_stay_are_judged_while_another_one_is_unloaded():
    recording = run_of("two_contact_rod", "active.left_end=[[0 s, 1.5 s]]", duration=2.0)
    unloading = np.flatnonzero((recording["t"] >= 1.5) & (recording["t"] < 1.75))
    assert osc.metrics(recording)["task"]["word"] == "OK"
    for contact, words in ((0, ("OK", "OK")), (1, ("POOR", "LOST"))):
        words_found = []
        for name in ("alpha_true", "closed"):
            values = recording[name].copy()
            values[unloading, contact] = 0
            found = osc.Recording(recording.meta, dict(recording.channels) | {name: values})
            words_found.append(osc.metrics(found)["task"]["word"])
        assert tuple(words_found) == words


def test_a_contact_that_is_not_named_any_more_is_not_judged_and_one_that_is_named_is():
    """The recording is read in pieces of any length; earlier versions did not record the names."""
    ticks = np.arange(TICKS)[:, None]
    jump = np.where((ticks >= 1500) & (ticks < 2000), 0.0, 10.0)
    named = (ticks < 1500) | (ticks >= 1600)
    for extra, unloaded in (({"contact_named": named}, range(1500, 1600)), ({}, ())):
        recording = made({"force_rise_s": 0.05}, alpha_cmd=jump, alpha_true=jump, **extra)
        for length in (1, 7, TICKS):
            judged = JudgedTicks(recording)
            flags = []
            for start in range(0, TICKS, length):
                names = [name for name in READ if name in recording]
                flags.append(judged.add({k: recording[k][start : start + length] for k in names}))
            contacts, magnitudes, run = map(np.concatenate, zip(*flags, strict=True))
            assert_array_equal(np.flatnonzero(~contacts[1000:, 0]) + 1000, unloaded)
            assert_array_equal(magnitudes, contacts)
            assert run[1000:].all()


def test_the_overshoot_of_a_step_is_not_that_of_a_release_after_it():
    command = np.full((TICKS, 1), 10.0)
    command[2000:2200] = 14.0
    command[2200:] = 0.0
    truth = command.copy()
    truth[2200:2300] = 9.0  # still pressed
    (_, step) = osc.metrics(made({"force_steps_s": [2.0]}, alpha_cmd=command, alpha_true=truth))[
        "steps"
    ]
    assert step["to_N"] == 14.0 and step["overshoot_N"] == 0.0


def test_the_gravest_word_is_given_and_every_reason():
    both = changed("closed", 2000, 2100, 0) | changed("status", 1500, 1501, 2)
    task = osc.metrics(made(**both))["task"]
    assert task["word"] == "LOST"
    lost, often, held_ticks = task["why"]
    assert "was lost" in lost and "5.0% of its judged time" in often and "1 of 3000" in held_ticks


LIMITS = {
    "force_rms": (0.2, changed("alpha_true", 1000, TICKS, 8.5)),
    "force_peak": (3.0, changed("alpha_true", 2000, 2001, 21.0)),
    "path": (0.1, changed("motion_error", 2000, 2001, 0.006)),
    "limit_cycle": (0.2, {"alpha_true": 10 + np.sin(np.arange(TICKS) * 0.06)[:, None]}),
    "open_share": (0.03, changed("closed", 2000, 2040, 0)),
    "lost_time": (0.2, changed("closed", 2000, 2060, 0)),
    "distance": (0.2, changed("motion_error", 2000, 2001, 0.08)),
    "angle": (0.5, changed("motion_error", 2000, 2001, turned)),
    "held_share": (0.1, held),
}


def test_each_limit_is_a_key_of_the_scenario():
    """A run that fails passes once the scenario permits what failed it."""
    of_rules = {rule.limit for rule in RULES if isinstance(rule.limit, str)}
    assert set(LIMITS) == set(VerdictSpec.model_fields) == of_rules
    for key, (permitted, channels) in LIMITS.items():
        assert osc.metrics(made(**channels))["task"]["failed"], key
        beside = {"lost_time": {"open_share": 0.1}, "distance": {"path": 0.2}}
        limits = {key: permitted} | beside.get(key, {})
        scenario = {"name": "made", "verdict": limits}
        task = osc.metrics(made({"scenario": scenario}, **channels))["task"]
        assert not task["failed"], (key, task)


def test_a_new_rule_is_one_row():
    """A quantity of every force, a limit and a sentence are all that a rule needs."""
    row = Rule("HARD", "force", "mean_N", 9.0, "{name} presses {mean_N:g} N of {limit:g} N")
    facts = {"run": [], "contact": [], "doubt": [], "force": [{"name": "tip", "mean_N": 10.0}]}
    task = judge_task(facts, VerdictSpec(), [row])
    assert task == {"word": "HARD", "failed": True, "why": ["tip presses 10 N of 9 N"]}


def landing_at(tick, **channels):
    """Open up to a tick, then 25 N for 100 ms, then as commanded."""
    truth = np.full((TICKS, 1), 10.0)
    truth[:tick] = 0.0
    truth[tick : tick + 100] = 25.0
    phase = np.where(np.arange(TICKS) < tick, 1, 2)[:, None]
    closed = np.arange(TICKS)[:, None] >= tick
    return {"alpha_true": truth, "contact_phase": phase, "closed": closed, **channels}


def test_a_run_that_begins_with_an_approach_is_judged_by_its_phases():
    """The approach has no force limits, the landing an overshoot, closed contacts an rms error."""
    verdict = osc.metrics(made(**landing_at(1500)))
    force = verdict["force"]["tip"]
    assert verdict["task"]["word"] == "OK" and force["rms_error_N"] == 0.0 == force["peak_error_N"]
    (landing,) = verdict["steps"]
    assert landing["what"] == "first contact" and landing["overshoot_rel"] == approx(1.5)
    assert verdict["first_contact_s"] == {"tip": approx(1.5)}
    late = osc.metrics(made(**landing_at(2800)))["task"]
    assert late["word"] == "POOR" and "closed too late; run it longer" in late["why"][0]


def test_a_power_ratio_that_is_large_has_a_reason():
    for share, words in ((1.41, ("141 %", "power into the contacts")), (0.01, ("ratio 1 %",))):
        verdict = osc.metrics(made(power_projected=np.full(TICKS, share)))
        assert any(all(word in row for word in words) for row in rows_of(verdict))


AWAY = (
    "contacts.left_end.face.motion={type: conveyor, direction: [-0.5, -0.2, -0.84], "
    "signals: [{type: minimum_jerk, value: 1, start: 1 s, duration: 0.2 s}]}"
)


@parametrize(
    "words, code, verdict, failed, sentence",
    [
        ([], 0, "OK", False, "written to"),
        (["--set", "model_error.arm_mass=1.01"], 1, "DOUBTFUL", False, "before it ran: "),
        (["--set", AWAY], 1, "STOPPED", True, "contact 'left_end' was lost"),
    ],
)
def test_runs_end_with_the_exit_code_of_their_verdict(
    words, code, verdict, failed, sentence, tmp_path, no_figures
):
    """A left face that moves away faster than the arms leaves its contact open."""
    result = call("run two_contact_rod --duration 1.6", *words, "--out", tmp_path)
    task = read_json(tmp_path / "metrics.json")["task"]
    assert (result.exit_code, task["word"], task["failed"]) == (code, verdict, failed), task
    assert f"verdict: {verdict}" in result.stdout and sentence in result.stdout


def test_the_first_reason_is_kept_beyond_a_stop():
    """A law of one's own that returns nonsense stops the arms; the cause is the first tick's."""
    task = osc.load_scenario("two_contact_rod", ["duration=1.05 s"])
    recording = run_of(task.replaced(laws=osc.Laws(force=lambda *forces: 5.0)))
    assert recording.meta["end_state"] == "SAFE_STOP"
    assert recording.meta["first_reason"].startswith("at 0.000 s: the force law returned 5.0")
    (stopped, *_) = osc.metrics(recording)["task"]["why"]
    assert "the force law returned 5.0: return 2 finite numbers" in stopped


def test_a_run_too_short_to_be_judged_is_refused_with_its_length():
    recording = run_of("two_contact_rod", "duration=0.02 s")
    with invalid_input("20 ticks ends before t = 1 s"):
        osc.metrics(recording)


# Contact or not, collision or not: the monitor on signals whose story is known.


DT = 1e-3


test_what_is_no_threshold_is_refused = refusals(
    invalid_input,
    {
        "above force_off": lambda: MonitorLimits(force_on=0.4, force_off=0.4),
        "power: must be > 0; got 0": lambda: MonitorLimits(power=0.0),
        "power: must be > 0; got -0.05": lambda: MonitorLimits(power=-0.05),
    },
)


@parametrize("seed", range(4))
def test_a_series_is_watched_as_tick_by_tick(seed):
    """By the rules of test_law_phases.py; ticks that are passed over bring nothing new.

    Contacts are lost and made again, with bursts.
    """
    rng = np.random.default_rng(seed)
    alpha = np.repeat(rng.choice([8.0, 0.0, 0.45, 3.0], (60, 2)), rng.integers(1, 40, 60), axis=0)
    alpha = alpha + 0.02 * rng.standard_normal(alpha.shape)
    speed = 0.02 * rng.standard_normal(alpha.shape)
    closed, collision = watch_series(ContactMonitor(2, DT), alpha, speed)
    states = [(False, 0.0, 0.0, 0.0, 0.0, False)] * 2
    for k, now in enumerate(aligned(alpha, speed)):
        states = [
            watched(state, *given, DT, MonitorLimits(), 0.0)
            for state, *given in aligned(states, *now)
        ]
        assert [(row[0], row[-1]) for row in states] == [*aligned(closed[k], collision[k])]
    assert collision.any() and not closed.all() and closed.any()

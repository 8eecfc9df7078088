"""Sweeps: points, rows equal to single runs, one table however it came about, what runs share."""

import html
import json
import multiprocessing
import os
import re
import signal
import subprocess

import numpy as np
import psutil
import pyarrow
from command_line import answered, call, read_json
from complaints import invalid_input
from numpy.linalg import norm
from processes import COMMAND, alive, wait_until
from pyarrow import parquet
from pytest import approx, mark, param, raises
from rigs import assert_near, vector
from samples import aligned, parametrize
from scenario_runs import assert_same_run, rig_of, run_of
from scipy import stats
from scipy.stats import qmc

import osc_contact as osc
from osc_contact import robots
from osc_contact.contacts.detection import collision_shapes
from osc_contact.lab.checks.preflight import judge_rig, require_ready
from osc_contact.lab.runs.run import start
from osc_contact.lab.sweeps import workers
from osc_contact.lab.sweeps.report import variances, write_report
from osc_contact.lab.sweeps.rows import RigBuilder, make_rows, robot_key
from osc_contact.lab.sweeps.study import SweepStudy, parse_distribution
from osc_contact.lab.sweeps.sweep import ROWS, TABLE, RowFile, run_study

U = np.linspace(0.01, 0.99, 7)
SHORT = ("duration=1.02 s", "control.rate=250 Hz")
MASSES = "model_error.object_mass=uniform(0.8, 1.2)"
NORMALS = "contacts.left_end.face.normal=tilt(5 deg)"


def rod(samples, *vary, **how):
    return SweepStudy.of("two_contact_rod", vary, samples, overrides=SHORT, **how)


# --- what a key may be ----------------------------------------------------------------------------


@parametrize(
    "words, oracle",
    {
        "uniform(-2, 3)": stats.uniform(-2, 5),
        "normal(4, 0.5)": stats.norm(4, 0.5),
        "loguniform(1e-3, 10)": stats.loguniform(1e-3, 10),
    },
)
def test_numbers_are_those_of_scipys_distributions(words, oracle):
    found = [float(parse_distribution(words).draw(vector(u), None)[0]) for u in U]
    assert_near(found, oracle.ppf(U), rtol=1e-9)


def test_choices_and_integers_are_all_as_likely():
    u = (np.arange(3000) + 0.5) / 3000
    for words, values in (
        ("choice(filter, least_squares, [1, 2])", {"filter", "least_squares", "[1, 2]"}),
        ("integers(-1, 1)", {"-1", "0", "1"}),
    ):
        drawn = [parse_distribution(words).draw(vector(x), None)[0] for x in u]
        assert {v: drawn.count(v) for v in values} == dict.fromkeys(values, 1000)


def test_factors_multiply_and_units_stay_with_their_numbers():
    factor = parse_distribution("factor(0.5, 1.5)")
    for text, before in {"5.0": 4, "12.5 mm": "10 mm", "[1.25, 2.5 N]": [1, "2 N"]}.items():
        assert factor.draw([0.75], before)[0] == text
    found = parse_distribution("uniform(5 mm, 10 mm)").draw([0.5], None)
    assert found == ("7.5 mm", {" [mm]": 7.5})
    with invalid_input("multiplies a number"):
        factor.draw([0.5], "filter")


def test_tilted_directions_fill_their_cap_evenly():
    """On a sphere the height above the rim of a cap is uniform (Archimedes)."""
    normal = vector(0.5, 0.2, 0.84) / norm([0.5, 0.2, 0.84])
    u = np.random.default_rng(0).random((4000, 2))
    tilt = parse_distribution("tilt(20 deg)")
    drawn = np.array([json.loads(tilt.draw(x, normal.tolist())[0]) for x in u])
    assert_near(norm(drawn, axis=1), 1.0, atol=1e-12)
    rim = np.cos(np.deg2rad(20))
    height = (drawn @ normal - rim) / (1 - rim)
    assert height.min() > -1e-12
    assert stats.kstest(height, "uniform").pvalue > 0.01
    sideways = drawn - np.outer(drawn @ normal, normal)
    assert norm(sideways.mean(axis=0)) < 0.01


@parametrize(
    "words",
    [
        "0.8",
        "gauss(0, 1)",
        "uniform(1, 0)",
        "uniform(1 mm, 2 m)",
        "uniform(1)",
        "uniform(a, b)",
        "normal(1, 0)",
        "loguniform(0, 1)",
        "integers(1.5, 2)",
        "choice(a, )",
        "tilt(200 deg)",
        "tilt(5 N)",
        "factor(1 m, 2 m)",
    ],
)
def test_what_is_not_understood_is_refused_with_how_it_is_written(words):
    with invalid_input(r"written|write one of"):
        parse_distribution(words)


# --- points ---------------------------------------------------------------------------------------


@parametrize("design, points", {"halton": qmc.Halton, "sobol": qmc.Sobol})
def test_points_are_scipys_and_those_behind_a_block_go_on(design, points):
    study = rod(3000, "squeeze=uniform(0, 1)", "seed=integers(0, 9)", design=design, seed=4)
    oracle = points(2, scramble=True, rng=4).random(2048)
    for i in (0, 5, 1023, 1024, 2047):
        assert study.sample(i).shown["squeeze"] == approx(oracle[i, 0], abs=1e-12)
        assert study.sample(i).seed == int(oracle[i, 1] * 10)


def test_a_sample_does_not_depend_on_how_many_there_are():
    for design in ("halton", "sobol", "random"):
        few, many = (rod(n, MASSES, NORMALS, design=design) for n in (10, 5000))
        assert few.fingerprint == many.fingerprint
        assert [few.sample(i) for i in range(10)] == [many.sample(i) for i in range(10)]
    assert rod(4, MASSES).fingerprint != rod(4, MASSES, seed=1).fingerprint


def test_a_grid_has_every_combination_and_both_ends():
    study = rod(
        3,
        "squeeze=uniform(5 N, 15 N)",
        "control.force.reading=choice(filter, least_squares)",
        design="grid",
    )
    assert study.rows == 6
    found = [study.sample(i).overrides for i in range(6)]
    assert {one["squeeze"] for one in found} == {"5.0 N", "10.0 N", "15.0 N"}
    assert len({json.dumps(one) for one in found}) == 6


@parametrize(
    "complaint, vary",
    {
        "path.to.key=distribution": ["squeeze"],
        "at least one": [],
        "varies twice": ["squeeze=uniform(0, 1)", "squeeze=uniform(0, 2)"],
        "squeese": ["squeese=uniform(0, 1)"],
        "multiplies a number": ["duration=factor(1, 2)", "control.nothing.at.all=factor(1, 2)"],
    },
)
def test_a_study_that_cannot_be_made_is_refused_before_its_runs(vary, complaint):
    with raises((osc.InvalidInputError, osc.ScenarioError), match=complaint):
        SweepStudy.of("two_contact_rod", vary, 3)


def test_sobol_indices_are_those_of_ishigamis_function():
    """sin x + 7 sin² y + 0.1 z⁴ sin x on (−π, π)³, indices by Ishigami and Homma 1990."""
    keys = [f"model_error.{name}" for name in ("face_tilt", "face_tilt_about", "face_offset")]
    study = rod(1024, *(f"{key}=uniform({-np.pi}, {np.pi})" for key in keys), design="saltelli")
    assert study.rows == 5 * 1024
    points = [study.sample(i).shown for i in range(study.rows)]
    x, y, z = (np.array([one[key] for one in points]) for key in keys)
    error = np.sin(x) + 7 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)
    table = pyarrow.table({"motion.rms_error_m": error})
    found = variances(table, study, "motion.rms_error_m")
    first, total = ([found[key][kind] for key in keys] for kind in ("first", "total"))
    assert_near(first, (0.3139, 0.4424, 0.0), atol=0.03)
    assert_near(total, (0.5576, 0.4424, 0.2437), atol=0.03)
    assert variances(table.slice(0, 9), study, "motion.rms_error_m") == {}
    with invalid_input("power of two, such as 1024"):
        rod(1000, MASSES, design="saltelli")


def test_a_key_with_two_numbers_is_exchanged_as_one():
    study = rod(2, MASSES, NORMALS, "squeeze=uniform(0, 1)", design="saltelli")
    A, B, *exchanged = (study.sample(5 + i).shown for i in range(5))
    tilt = [name for name in A if "normal" in name]
    assert len(tilt) == 2 and all(A[name] != B[name] for name in A)
    for names, one in aligned(([next(iter(A))], tilt, ["squeeze"]), exchanged):
        assert one == A | {name: B[name] for name in names}


@parametrize(
    "name, vary",
    [
        ("two_contact_rod", [MASSES, NORMALS, "seed=integers(0, 99)"]),
        ("panda_edge", ["gains.force.integral=factor(0.5, 1.5)", "plant.friction=uniform(0, 0.1)"]),
        param(
            "workcell",
            ["seed=integers(0, 99)", "sensors.wrist.delay=uniform(1 ms, 3 ms)"],
            marks=mark.slow,
        ),
    ],
)
def test_every_row_equals_the_run_of_its_command(name, vary, tmp_path, no_figures):
    study = SweepStudy.of(name, vary, 2, overrides=SHORT)
    for row in make_rows(study, [0, 1]):
        call(study.command(row["row"]).removeprefix("osc-contact "), "--out", tmp_path)
        verdict = read_json(tmp_path / "metrics.json")
        assert row["word"] == verdict["task"]["word"] and row["seed"] == verdict["seed"]
        groups = {key: verdict[key] for key in ("motion", "power", "status", "contact_fraction")}
        groups |= {f"force.{one}": force for one, force in verdict["force"].items()}
        for group, values in groups.items():
            for key, value in values.items():
                close = None if value is None else approx(value, rel=1e-9, abs=1e-12)
                assert row[f"{group}.{key}"] == close, (group, key)


# --- rows -----------------------------------------------------------------------------------------


def test_runs_that_fail_keep_their_reason():
    study = rod(2, "object.pose.xyz=choice([0, 0, 0.2], [0, 5, 0.2])", design="grid")
    fine, lost = make_rows(study, [0, 1])
    assert fine["word"] == "OK" and not fine["failed"]
    assert lost["word"] == "REFUSED" and lost["failed"] and "m" in lost["why"]
    table = run_study(study, workers=1)
    assert table.column("word").to_pylist() == ["OK", "REFUSED"]
    assert table.column("motion.rms_error_m").to_pylist()[1] is None


def test_doubts_stand_in_the_rows_and_are_not_logged(caplog):
    study = rod(1, "model_error.object_mass=uniform(1.1, 1.2)")
    require_ready(rig_of(study.scenario(study.sample(0))))
    assert "model_error" in caplog.text  # a single run tells them
    caplog.clear()
    (row,) = make_rows(study, [0])
    assert "model_error" in row["doubts"] and not caplog.records


def test_runs_too_short_to_be_judged_are_refused():
    with invalid_input("judged"):
        osc.sweep("two_contact_rod", [MASSES], 3, overrides=["duration=1 s"])


# --- one table ------------------------------------------------------------------------------------


def test_table_is_the_same_in_one_process_in_two_and_where_a_worker_is_killed(tmp_path):
    how = {"vary": [MASSES, NORMALS], "overrides": SHORT}
    alone = osc.sweep("two_contact_rod", **how, samples=10, workers=1)
    killed = []

    def kill_one(done, total):
        if not killed:
            killed.append(multiprocessing.active_children()[0])
            os.kill(killed[0].pid, signal.SIGKILL)

    how["out"] = tmp_path
    both = osc.sweep("two_contact_rod", **how, samples=10, workers=2, progress=kill_one)
    assert killed and alone.equals(both)
    assert parquet.read_table(tmp_path / TABLE).equals(alone)
    more = osc.sweep("two_contact_rod", **how, samples=12, workers=1)
    assert more.num_rows == 12 and more.slice(0, 10).equals(alone)
    with invalid_input("another study"):
        osc.sweep("two_contact_rod", **how, samples=12, seed=1)


def test_workers_have_the_environment_of_the_moment(monkeypatch):
    """Also where the process that they are forked from has begun with another one."""
    for value in ("1", "2"):
        monkeypatch.setenv("OSC_CONTACT_OF_A_TEST", value)
        with workers._processes(1) as executor:
            assert executor.submit(os.getenv, "OSC_CONTACT_OF_A_TEST").result() == value


def test_killed_in_the_middle_and_run_again_it_ends_with_the_same_table(tmp_path):
    """Workers end with a killed sweep."""
    line = f"sweep two_contact_rod --samples 40 --workers 2 --out {tmp_path} --vary"
    rows = tmp_path / ROWS
    changes = [word for one in SHORT for word in ("--set", one)]
    command = [*COMMAND, *line.split(), MASSES, *changes]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        wait_until(lambda: rows.exists() and rows.read_bytes().count(b"\n") > 3, process=process)
        workers = [one.pid for one in psutil.Process(process.pid).children(recursive=True)]
        process.kill()
    assert len(workers) >= 2
    wait_until(lambda: not any(map(alive, workers)), 2.0)
    kept = rows.read_bytes()
    assert kept.count(b"\n") > 3 and not (tmp_path / TABLE).exists()
    rows.write_bytes(kept + b'{"row": 39, "seed"')  # killed while it wrote
    study = rod(8, MASSES)
    file = RowFile(rows, study)
    file.close()
    count = sum(number < 8 for number in file.done)
    begun = []
    resumed = run_study(study, out=tmp_path, workers=1, progress=lambda n, _: begun.append(n))
    assert len(begun) == 8 - count < 8
    assert resumed.equals(run_study(study, workers=1))


def test_command_prints_what_became_of_the_runs(tmp_path):
    tilt = "model_error.face_tilt=uniform(0 deg, 2 deg)"  # no doubts before a run, as of masses
    line = f"sweep two_contact_rod --vary '{tilt}' --samples 6 --duration 1.02 --workers 1 --out"
    printed, summary = answered(line, tmp_path)
    assert "6 runs, 100.0% without a failed task: 6 OK" in printed.output
    table = parquet.read_table(tmp_path / TABLE).to_pydict()
    name = "force.left_end.rms_error_rel"
    assert summary["quantiles"][name]["50 %"] == approx(np.median(table[name]))
    column = "model_error.face_tilt [deg]"
    rho = stats.spearmanr(table[column], table[name]).statistic
    assert summary["sensitivities"][name][column] == approx(rho)
    worst = summary["worst"][0]
    assert worst["command"].startswith("osc-contact run two_contact_rod --set duration=1.02 --set")
    both = [max(table[f"force.{end}.rms_error_rel"]) for end in ("left_end", "right_end")]
    assert worst["value"] == max(both)


def test_report_shows_everything_in_one_page(tmp_path):
    study = rod(5, MASSES, "object.pose.xyz=choice([0, 0, 0.2], [0, 5, 0.2])", design="random")
    table = run_study(study, workers=1)
    summary = write_report(table, study, tmp_path)
    failed = table.column("failed").to_pylist()
    assert summary["success_rate"] == approx(1 - sum(failed) / 5) and 0 < sum(failed) < 5
    assert summary == read_json(tmp_path / "summary.json")
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 2
    assert "://" not in page and set(re.findall('src="(.{5})', page)) == {"data:"}
    assert {path.name for path in tmp_path.glob("*.svg")} == {"errors.svg", "causes.svg"}
    worst = failed.index(True)
    assert summary["worst"][0]["row"] in np.flatnonzero(failed)
    assert html.escape(study.command(worst)) in page and "REFUSED" in page
    assert "of its variance" not in page


@mark.slow
def test_report_shows_the_shares_of_a_saltelli_design(tmp_path):
    study = rod(2, MASSES, "squeeze=uniform(0, 1)", design="saltelli")
    found = write_report(run_study(study, workers=1), study, tmp_path)["variances"]
    page = (tmp_path / "report.html").read_text()
    for keys in found.values():
        for key, share in keys.items():
            assert (
                f"{key}: {share['total']:.0%} of its variance, {share['first']:.0%} alone" in page
            )
    assert {len(keys) for keys in found.values()} == {2}


def test_scenarios_made_in_python_are_swept_and_their_laws_refused():
    scenario = osc.load_scenario("two_contact_rod", SHORT)
    study = SweepStudy.of(scenario, [MASSES], 1)
    assert study.command(0) is None
    named = SweepStudy.of("two_contact_rod", [MASSES], 1, overrides=SHORT)
    (one,) = make_rows(study, [0])
    (other,) = make_rows(named, [0])
    assert one == other
    own = scenario.replaced(laws=osc.Laws())
    with invalid_input("laws"):
        SweepStudy.of(own, [MASSES], 1)


# What the runs of a sweep share: every number of a recording is that of the run by itself.


def test_rigs_that_share_chains_are_those_built_alone(monkeypatch):
    """In an order in which every chain, and every robot, that is kept has been used by another run.

    Preflight of a robot is gone through once, whatever the controller's model has wrong.
    """
    builder = RigBuilder()
    judged = []
    monkeypatch.setattr(
        "osc_contact.lab.sweeps.rows.judge_rig", lambda rig: judged.append(rig) or judge_rig(rig)
    )
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
        alone = run_of(scenario)
        sharing = run_of(scenario, build=builder.rig, check=builder.require_ready)
        assert_same_run(alone, sharing)
        clocks = {"wall_s": 0.0, "cpu_s": 0.0, "date": ""}
        assert alone.meta | clocks == sharing.meta | clocks
        assert len(alone.meta["doubts"]) == (scenario.model_error.object_mass != 1.0)
    assert len(judged) == 2
    rigs = [builder.rig(scenario) for scenario in scenarios]
    assert len({id(rig.chain) for rig in rigs}) == 1 and len({id(rig.model) for rig in rigs}) == 2
    assert len({rig.q_contact.tobytes() for rig in rigs}) == 2  # the normals do vary


def leaves(content, path=()):
    """Paths and values of all numbers and words of nested lists and mappings."""
    pairs = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in pairs:
        if isinstance(value, dict | list):
            yield from leaves(value, (*path, key))
        else:
            yield ((*path, key), value)


def edited(value):
    """Values near this one; of a word those that the workcell's keys may have."""
    if isinstance(value, bool):
        return [not value]
    if isinstance(value, str):
        return [f"{value}_", "chain", "least_squares", "detected", "rigid", "sine", "ignored"]
    return [1.0] if value is None else [value + 1e-9, value + 1, 2 * value, value - 1]


def scenarios_with_one_edit(scenario, *sections):
    """(path, scenario) for each key, of some sections, but those of which no edit is a scenario."""
    content = scenario.as_dict()
    paths = ((path, x) for path, x in leaves(content) if not sections or path[0] in sections)
    for path, value in paths:
        for new in edited(value):
            other = json.loads(json.dumps(content))
            place = other
            for key in path[:-1]:
                place = place[key]
            place[path[-1]] = new
            try:
                made = osc.Scenario.from_dict(other, scenario.source)
            except osc.ScenarioError:
                continue
            if made != scenario:
                yield (path, made)
                break


#: Keys that a plan takes the place of.
WITHOUT_A_PLAN = ("force", "active", "motion", "squeeze", "tare")


def test_every_key_of_a_scenario_makes_another_robot_but_errors_and_limits():
    """A key that is left out by mistake would give a run another run's robot, silently."""
    scenario = osc.load_scenario("workcell")
    found = dict(scenarios_with_one_edit(scenario))
    paths = [path for path, _ in leaves(scenario.as_dict())]
    assert len(found) > 0.9 * len(paths)
    assert {path[0] for path in found} == {path[0] for path in paths} - {"plan"}
    stage = {"name": "press", "forces": {scenario.contacts[0].name: 5.0}, "within": 2.0}
    unplanned = {key: x for key, x in scenario.as_dict().items() if key not in WITHOUT_A_PLAN}
    planned = [
        osc.Scenario.from_dict(
            unplanned | {"plan": {"largest": most, "stages": [stage | {"until": "at_rest"}]}},
            scenario.source,
        )
        for most in (20.0, 30.0)
    ]
    assert len({robot_key(one) for one in (scenario, *planned)}) == 3
    same = {path for path, other in found.items() if robot_key(other) == robot_key(scenario)}
    left_out = {path for path in found if path[0] in ("model_error", "verdict")}
    assert same == left_out - {("model_error", "hidden_mass")}
    assert {path[1] for path in left_out if path[0] == "model_error"} == set(
        type(scenario.model_error).model_fields
    )
    elsewhere = scenario.with_source(scenario.source.with_name("other.yaml"))
    assert robot_key(elsewhere) != robot_key(scenario)


@parametrize("name", ["two_contact_rod", "workcell"])
def test_what_is_shared_of_a_robot_does_not_depend_on_errors_and_limits(name):
    """Each key that the robot's key leaves out is changed, alone; the rig is built from nothing."""
    scenario = osc.load_scenario(name, ["plant.friction=0.1", "duration=1 s"])
    rig = osc.build_rig(scenario)
    found = judge_rig(rig)
    for path, other in scenarios_with_one_edit(scenario, "model_error", "verdict"):
        if path[1] == "hidden_mass":
            continue
        one = osc.build_rig(other)
        assert judge_rig(one) == found, path
        for array in ("q_contact", "q_start", "placements", "owners"):
            assert getattr(one, array).tobytes() == getattr(rig, array).tobytes(), path
        assert one.chain.model == rig.chain.model
        assert (
            one.references.overview[1].X_WD.tobytes() == rig.references.overview[1].X_WD.tobytes()
        )


def test_files_that_changed_are_read_anew_and_what_is_returned_is_nobodys(tmp_path):
    """Cached files are identified by their bytes: same length, same second, another robot."""
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


def test_start_leaves_the_controller_that_only_gave_first_torques_behind():
    """Both controllers of a start know nothing of one another."""
    _, controller = start(rig_of())
    assert not controller.records.memory.ticked

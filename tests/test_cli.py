"""The command line: what it says, what it writes, how it exits."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import typer
from pytest import MonkeyPatch, approx, fixture, mark
from scene_samples import read_commands
from typer.testing import CliRunner

import osc_contact
from osc_contact.cli import app
from osc_contact.console import PARTIAL
from osc_contact.errors import PlantError
from osc_contact.plants.rigid import RigidPlant
from osc_contact.recorder import Recording
from osc_contact.scenarios import load_scenario
from osc_contact.visual.plots import PRINT

ROOT = Path(__file__).parents[1]
SHORT = ("--plant", "rigid", "--duration", "1.05", "--set", "plant.step=1 ms")


def call(*words):
    """Invoke the command line; anything but an exit code is the test's own failure."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def refused(*words):
    """The message of a command that must end with exit code 2, without a traceback."""
    result = call(*words)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    assert not result.stdout, "complaints belong on stderr"
    return result.stderr


@fixture(scope="module")
def done(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return folder, call(
        "run",
        "two_contact_rod",
        *SHORT,
        "--out",
        folder,
        "--seed",
        "7",
        "--json",
        folder / "deep" / "again.json",
    )


def test_version_and_help():
    assert call("--version").stdout.strip() == f"osc-contact {osc_contact.__version__}"
    text = call("--help").stdout
    for command in ("run", "reproduce", "view", "inspect", "list", "bench"):
        assert command in text
    assert call("run", "--help").exit_code == 0


def test_alone_it_says_what_to_do_first():
    result = call()
    assert result.exit_code == 0 and "examples" in result.stdout and "--help" in result.stdout
    told = [line.split()[1] for line in result.stdout.splitlines() if line.startswith("  osc-")]
    assert len(told) == 5 and set(told) <= set(typer.main.get_command(app).commands)
    assert "No such command" in call("insepct").output


def test_examples_are_the_programs_of_the_docs(tmp_path):
    folder = tmp_path / "mine"
    result = call("examples", folder)
    assert result.exit_code == 0, result.output
    files = sorted(folder.iterdir())
    assert len(files) >= 10 and files[0].name == "01_osc_contact.py"
    first = files[0].read_text(encoding="utf-8")
    readme = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    assert first.split("\n", 2)[2] in readme and "panda_edge" in first
    for file in files:
        compile(file.read_text(encoding="utf-8"), str(file), "exec")
    assert "is there already" in refused("examples", folder)


def test_list_names_scenarios(tmp_path):
    result = call("list", "--json", tmp_path / "list.json")
    assert result.exit_code == 0 and "two_contact_rod" in result.stdout
    found = json.loads((tmp_path / "list.json").read_text())
    assert set(found["scenarios"]) == set(osc_contact.list_scenarios())


def test_inspect_says_what_the_contact_state_is(tmp_path):
    result = call("inspect", "two_contact_rod", "--json", tmp_path / "i.json")
    assert result.exit_code == 0
    assert "d = 5 independent motions" in result.stdout
    assert "constrain r = 2 of them; 3 motions stay free" in result.stdout
    assert "mm apart (skew: no single frame's axes hold both)" in result.stdout
    found = json.loads((tmp_path / "i.json").read_text())
    assert set(found) == {
        "d",
        "r",
        "free_motions",
        "contacts",
        "N",
        "T",
        "free",
        "conditioning",
        "report",
    }
    assert (found["d"], found["r"], found["free_motions"]) == (5, 2, 3)
    assert found["contacts"] == ["left_end", "right_end"]
    N = np.array(found["N"])
    T = np.array(found["T"])
    assert N.shape == (6, 2) and T.shape == (6, 4) and np.abs(N.T @ T).max() < 1e-12
    assert all(sentence in result.stdout for sentence in found["report"])
    assert f"{N[0, 0]:.4f}" in result.stdout, "the table shows N"


def test_run_leaves_everything_behind(done):
    folder, result = done
    assert result.exit_code == 0, result.output
    names = {path.name for path in folder.iterdir()}
    figures = {
        f"{n}{s}"
        for n in ("contact_forces", "power", "tracking", "torques")
        for s in (".png", ".svg")
    }
    recording = {"recording.npz", "recording.times.npz"}
    assert names == figures | recording | {"metrics.json", "scene.html", "deep"}
    for name in figures:
        start = (folder / name).read_bytes()[:300]
        assert start.startswith(b"\x89PNG") or b"<svg" in start or b"<?xml" in start
        assert (folder / name).stat().st_size > 5000
    paths = {command.get("path") for command in read_commands(folder / "scene.html")}
    assert "/meshcat/contacts/left_end/true" in " ".join(str(p) for p in paths)
    assert "\x1b" not in result.output and "━" not in result.stderr, "no progress when piped"
    assert str(folder) in result.stdout


def test_metrics_have_the_documented_keys(done):
    folder, _ = done
    verdict: dict[str, Any] = json.loads((folder / "metrics.json").read_text())
    assert set(verdict) == {
        "scenario",
        "plant",
        "seed",
        "duration_s",
        "ticks",
        "real_time_factor",
        "force",
        "motion",
        "contact_fraction",
        "power",
        "tick_us",
        "loop",
        "status",
        "at_limit",
        "first_contact_s",
        "steps",
        "judged_ticks",
        "task",
        "joint_losses",
        "learned_friction",
    }
    assert (verdict["scenario"], verdict["plant"], verdict["seed"]) == (
        "two_contact_rod",
        "rigid",
        7,
    )
    assert verdict["ticks"] == 1050 and verdict["duration_s"] == approx(1.05)
    assert set(verdict["force"]) == set(verdict["contact_fraction"]) == {"left_end", "right_end"}
    for force in verdict["force"].values():
        assert set(force) == {
            "rms_error_N",
            "rms_error_rel",
            "peak_error_N",
            "peak_error_rel",
            "mean_command_N",
            "sensing_rms_rel",
            "limit_cycle_N",
            "limit_cycle_Hz",
            "limit_cycle_rel",
        }
        assert force["rms_error_rel"] < 1e-3
    assert set(verdict["motion"]) == {"rms_error_m", "rms_error_rad"}
    assert set(verdict["power"]) == {"total_rms_W", "projected_rms_W", "ratio"}
    assert set(verdict["tick_us"]) == {"p50", "p99", "p99_9", "max"}
    for joint in verdict["joint_losses"]:
        assert set(joint) == {"joint", "friction", "damping", "armature", "slides"}
    assert len(verdict["joint_losses"]) == 10  # passive ones too
    assert json.loads((folder / "deep" / "again.json").read_text()) == verdict


def test_recording_loads(done):
    recording = Recording.load(done[0] / "recording.npz")
    assert recording["tau"].shape == (1050, 8) and recording.meta["seed"] == 7
    assert recording.meta["scenario"]["plant"]["type"] == "rigid"
    assert osc_contact.metrics(recording)["ticks"] == 1050


def elsewhere(path, *words):
    """A command of the package as Python finds it on a path."""
    command = [sys.executable, "-m", "osc_contact", *words]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (path, ROOT)))}
    return subprocess.run(
        command, cwd=path, env=environment, capture_output=True, text=True, timeout=120
    )


@mark.parametrize(("command", "folder"), [("reproduce", "paper"), ("bench", "benchmarks")])
def test_programs_of_the_checkout_are_missed_with_a_cure(
    command: str, folder: str, tmp_path: Path
) -> None:
    """As installed: another package of the name may be there, a checkout is not."""
    shutil.copytree(ROOT / "osc_contact", tmp_path / "osc_contact")
    shutil.copytree(ROOT / "urdf", tmp_path / "urdf")
    (tmp_path / folder).mkdir()
    (tmp_path / folder / "__main__.py").write_text("print('another program')")
    result = elsewhere(tmp_path, command, "fig1")
    assert result.returncode == 2 and not result.stdout
    message = " ".join(result.stderr.split())
    assert f"needs the folder {folder}/ of a checkout" in message and "pip install -e" in message


def test_programs_of_the_checkout_are_not_mistaken_for_others(tmp_path):
    for name in ("paper", "benchmarks"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('another package')")
    figures = elsewhere(tmp_path, "reproduce", "--help")
    assert figures.returncode == 0 and "osc-contact reproduce" in figures.stdout, figures.stderr
    assert "fig8" in figures.stdout and "kinematic_stability" in figures.stdout
    assert elsewhere(tmp_path, "bench", "--help").returncode == 0


def test_reproduce_figures_without_a_run(tmp_path):
    for name in ("fig1", "fig4", "fig5"):
        result = call("reproduce", name, "--out", tmp_path, "--json", tmp_path / f"{name}.json")
        assert result.exit_code == 0, result.output
        assert (tmp_path / f"{name}.png").stat().st_size > 20000
        written = json.loads((tmp_path / f"{name}.json").read_text())["figures"]
        assert [Path(file) for file in written] == [tmp_path / f"{name}{s}" for s in PRINT]
    assert not (tmp_path / "two_contact_rod").exists(), "no run was needed"


@mark.slow
def test_reproduce_all_from_a_short_run(tmp_path):
    result = call("reproduce", "all", *SHORT, "--out", tmp_path, "--json", tmp_path / "all.json")
    assert result.exit_code == 0, result.output
    found = json.loads((tmp_path / "all.json").read_text())
    names = {
        "fig1",
        "fig2",
        "fig3",
        "fig4",
        "fig5",
        "fig6",
        "fig8",
        "kinematic_stability",
        "moving_face",
    }
    stems = {Path(file).stem for file in found["figures"] if file.endswith(".png")}
    assert names <= stems
    starts = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
    for stem in stems:
        for suffix in PRINT:
            assert (tmp_path / f"{stem}{suffix}").read_bytes().startswith(starts[suffix])
        assert (tmp_path / f"{stem}.png").stat().st_size > 20000
    for name in found["studies"]:
        assert (tmp_path / f"{name}.json").exists()
    assert json.loads((tmp_path / "two_contact_rod" / "metrics.json").read_text())["ticks"] == 1050
    verdicts = {name: one["verdict"] for name, one in found["paper"].items()}
    assert "contradicted" not in verdicts.values()
    assert all(verdicts[name] == "reproduced" for name in ("fig1", "fig2", "fig4", "fig6", "fig8"))
    assert verdicts["fig5"] == "partly reproduced", "no force steps in this run"
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    missing = 8 - len(verdicts)
    assert report.count("nothing here makes this figure yet.</div>") == missing
    for name in names:
        command = f"osc-contact reproduce {name} --plant rigid --duration 1.05 --set"
        assert command in report


def test_bench_tick(tmp_path):
    result = call("bench", "tick", "--ticks", "20", "--json", tmp_path / "tick.json")
    assert result.exit_code == 0, result.output
    cases = json.loads((tmp_path / "tick.json").read_text())
    assert {"two_contact_rod", "one_panda", "two_pandas", "saturated", "own_pair"} <= set(cases)
    for row in cases.values():
        assert set(row) == {"tick_p50_us", "floor_p50_us", "ratio", "p99_9_us"}
        assert row["ratio"] == approx(row["tick_p50_us"] / row["floor_p50_us"])
        assert row["p99_9_us"] >= row["tick_p50_us"] > 0.0


def test_bad_scenario_is_told_with_its_line(tmp_path):
    scenario = load_scenario("two_contact_rod")
    assert scenario.source is not None
    lines = scenario.source.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("squeeze:"))
    lines[at] = "squeeze: 10 mm"
    (tmp_path / "bad.yaml").write_text("\n".join(lines))
    assert f"bad.yaml:{at + 1}: squeeze" in refused("inspect", tmp_path / "bad.yaml")
    assert f"bad.yaml:{at + 1}: squeeze" in refused("run", tmp_path / "bad.yaml", *SHORT)


@mark.parametrize(
    ("words", "message"),
    [
        (("inspect", "two_contact_rob"), "no packaged scenario 'two_contact_rob'"),
        (("reproduce", "fig9"), "no figure 'fig9'; there are fig1"),
        (("reproduce", "fig2", "--set", "squeeze=1 N"), "fig2 is not made from a scenario"),
        (("bench", "tock"), "no benchmark 'tock'; there are tick, peers, "),
        (("run", "two_contact_rod", "--set", "squeeze"), "expected path.to.key=value"),
        (("run", "two_contact_rod", "--duration", "0.9"), "judged from t = 1 s"),
        (("run", "two_contact_rod", "--duration", "nan"), "duration"),
        (("run", "two_contact_rod", "--plant", "gazebo"), "gazebo"),
        (("run", "two_contact_rod", "--seed", "-1"), "greater than or equal to 0"),
        (("run", "two_contact_rod_mismatch", "--plant", "rigid"), "plant.type=mujoco"),
        (("run",), "Missing argument"),
        (("bench", "tick", "--ticks", "0"), "greater than or equal to 1"),
        (("dance",), "No such command"),
    ],
)
def test_bad_input_is_refused(
    words: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert message in " ".join(refused(*words).split())


def test_folder_that_cannot_be_written_is_refused_before_the_run(tmp_path):
    (tmp_path / "file").write_text("")
    message = refused("run", "two_contact_rod", *SHORT, "--out", tmp_path / "file")
    assert "exists" in message and "file" in message


def test_failed_run_exits_with_1_and_keeps_what_was_recorded(tmp_path, monkeypatch):
    command = RigidPlant.command

    def fragile(plant, tau, duration):
        if plant.time > 0.0195:
            raise PlantError("rigid plant diverged at t = 0.02 s")
        command(plant, tau, duration)

    monkeypatch.setattr(RigidPlant, "command", fragile)
    result = call("run", "two_contact_rod", *SHORT, "--out", tmp_path)
    assert result.exit_code == 1 and "diverged at t = 0.02 s" in result.stderr
    assert str(tmp_path / PARTIAL) in result.stderr and "Traceback" not in result.output
    assert PARTIAL in {path.name for path in tmp_path.iterdir()}
    assert len(list(tmp_path.iterdir())) == 2, "and its times"
    assert 20 <= len(Recording.load(tmp_path / PARTIAL)["t"]) <= 21


@mark.parametrize(
    ("package", "extra", "words"),
    [
        ("matplotlib", "plot", ("reproduce", "fig4")),
        ("matplotlib", "plot", ("run", "two_contact_rod", *SHORT)),
        ("mujoco", "sim", ("run", "two_contact_rod", "--duration", "1.05")),
    ],
)
def test_missing_extra_is_named(package, extra, words, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    message = refused(*words, "--out", tmp_path)
    assert f"{package} is not installed: pip install 'osc-contact[{extra}]'" in message
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


def test_installed_command_pipes_and_exits_like_the_application(tmp_path):
    command = [sys.executable, "-c", "from osc_contact.cli import app; app()"]
    bad = subprocess.run([*command, "inspect", "nope"], capture_output=True, text=True, timeout=60)
    assert bad.returncode == 2 and bad.stdout == ""
    assert bad.stderr.startswith("error: no packaged scenario 'nope'") and "\x1b" not in bad.stderr
    good = subprocess.run([*command, "list"], capture_output=True, text=True, timeout=60)
    assert good.returncode == 0 and good.stderr == "" and "\x1b" not in good.stdout


@fixture(scope="module")
def brief():
    scenario = load_scenario("two_contact_rod", ["plant.type=rigid", "plant.step=1 ms"])
    return osc_contact.run(scenario, duration=0.05)


def view_of(recording, folder, channels, meta):
    """A file with other channels and meta (None: left out) than the recording."""
    kept = {k: v for k, v in {**recording.channels, **channels}.items() if v is not None}
    told = {k: v for k, v in {**recording.meta, **meta}.items() if v is not None}
    return Recording(told, kept).save(folder / "bad.npz")


DRAWN = {
    "t": (),
    "q": (10,),
    "pose": (7,),
    "face_pose": (2, 7),
    "N": (6, 2),
    "contact_point": (2, 3),
    "contact_direction": (2, 3),
    "closed": (2,),
    "alpha_cmd": (2,),
    "alpha_meas": (2,),
    "alpha_true": (2,),
    "power_total": (),
    "power_projected": (),
}


@mark.parametrize("name", DRAWN)
def test_view_refuses_channels_that_no_run_of_its_scenario_has(name, brief, tmp_path):
    ticks = len(brief)
    page = tmp_path / "page.html"
    for shape in ((ticks, 0), (ticks, 3, 5), *([(ticks,)] if DRAWN[name] else [])):
        path = view_of(brief, tmp_path, {name: np.zeros(shape)}, {})
        words = refused("view", path, "--html", page)
        assert f"channel '{name}' has shape {shape[1:]}" in words and f"{DRAWN[name]}" in words
    for size in (np.inf, 1e300):
        path = view_of(brief, tmp_path, {name: np.full((ticks, *DRAWN[name]), size)}, {})
        assert f"channel '{name}' holds numbers above" in refused("view", path, "--html", page)
    path = view_of(brief, tmp_path, {name: None}, {})
    if name in ("t", "q", "pose"):
        assert f"'{name}'" in refused("view", path, "--html", page)
    else:
        assert call("view", path, "--html", page).exit_code == 0, "what is not there is not drawn"


@mark.parametrize(
    ("times", "words"),
    [
        (np.zeros(50), "does not grow"),
        (np.arange(50)[::-1], "does not grow"),
        (np.full(50, np.nan), "does not grow"),
    ],
)
def test_view_refuses_times_that_do_not_grow(times, words, brief, tmp_path):
    path = view_of(brief, tmp_path, {"t": times.astype(float)}, {})
    assert words in refused("view", path, "--html", tmp_path / "page.html")


def test_view_refuses_the_wrong_meta(brief, tmp_path):
    for key, words in (
        ("contact_names", "its contact_names are"),
        ("columns", "its columns are"),
        ("scenario", "does not hold the scenario"),
    ):
        for junk in (5, "x", [], {}, ["a"], [7], {"a": 1}):
            path = view_of(brief, tmp_path, {}, {key: junk})
            assert words in refused("view", path, "--html", tmp_path / "page.html")


@mark.parametrize("name", ["run.npz", "run.mcap"])
def test_view_refuses_files_that_are_no_recordings(name, brief, tmp_path):
    whole = brief.save(tmp_path / "whole.npz").read_bytes()
    rng = np.random.default_rng(8)
    bad = [b"", b"\0" * 100, b"name: two_contact_rod\n", whole[: len(whole) // 2], whole[100:]]
    bad += [bytes(rng.integers(0, 256, size, dtype=np.uint8)) for size in (1, 30, 3000)]
    bad += [b"PK\x03\x04" + bad[-1], b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + bad[-1]]
    for content in bad:
        path = tmp_path / name
        path.write_bytes(content)
        words = refused("view", path, "--html", tmp_path / "page.html")
        assert words.startswith("error: ") and name in words
    assert not (tmp_path / "page.html").exists()


@mark.parametrize("first", [0, 20])
def test_view_draws_ticks_that_were_held_where_things_were_before(first, brief, tmp_path):
    gaps = {name: brief[name].astype(float) for name in DRAWN if name != "t"}
    for values in gaps.values():
        values[first : first + 25] = np.nan
    path = view_of(brief, tmp_path, gaps, {})
    assert call("view", path, "--html", tmp_path / "page.html").exit_code == 0


def test_view_of_a_recording_shorter_than_a_picture(brief, tmp_path):
    short = Recording(brief.meta, brief.rows(0, 3)).save(tmp_path / "short.npz")
    assert call("view", short, "--html", tmp_path / "page.html").exit_code == 0


def test_view_makes_the_page_of_a_recording(done, tmp_path):
    recording = done[0] / "recording.npz"
    page = tmp_path / "deep" / "page.html"
    result = call("view", recording, "--html", page, "--time", "0.5")
    assert result.exit_code == 0 and f"written: {page}" in result.stdout.replace("\n", "")
    text = page.read_text(encoding="utf-8")
    assert '"still": 0.5' in text and "best single frame" in text
    moved, of_the_run = (
        [c for c in read_commands(file) if c["type"] != "set_object"]
        for file in (page, done[0] / "scene.html")
    )
    assert moved == of_the_run


def test_view_runs_a_scenario_and_writes_to_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short = ("--plant", "rigid", "--set", "plant.step=1 ms", "--duration", "0.05")
    result = call("view", "two_contact_rod", *short)
    assert result.exit_code == 0, result.output
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["two_contact_rod.html"]
    result = call("view", "two_contact_rod", *short, "--png", "still.png", "--time", "0.02")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "still.png").read_bytes().startswith(b"\x89PNG")
    result = call("view", "two_contact_rod", *short, "--gif", "moving.gif")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "moving.gif").read_bytes().startswith(b"GIF89a")
    result = call("view", "two_contact_rod", *short, "--mp4", "moving.mp4")
    assert result.exit_code == 0, result.output
    assert (tmp_path / "moving.mp4").read_bytes()[4:8] == b"ftyp"


@mark.parametrize("what", ["scenario", "recording"])
def test_view_live_serves_a_page_while_it_runs(what, tmp_path):
    scenario = load_scenario("two_contact_rod", ["plant.type=rigid", "plant.step=1 ms"])
    recording = osc_contact.run(scenario, duration=0.1).save(tmp_path / "short.npz")
    arguments = {
        "scenario": ("two_contact_rod", "--plant", "rigid", "--duration", "0.1"),
        "recording": (recording,),
    }[what]
    result = call("view", *arguments, "--live", "--hold", "0.1")
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("open http://127.0.0.1:")


def test_view_refuses_what_it_cannot_show(done, tmp_path, monkeypatch):
    recording = done[0] / "recording.npz"
    assert "give one of" in refused("view", recording, "--live", "--html", tmp_path / "x.html")
    assert "change runs, not recordings" in refused("view", recording, "--duration", "1")
    assert "no recording" in refused("view", tmp_path / "none.npz")
    words = refused("view", recording, "--gif", tmp_path / "x.gif", "--time", "0.5")
    assert "a GIF shows the whole recording" in words
    words = refused("view", recording, "--mp4", tmp_path / "x.mp4", "--time", "0.5")
    assert "a video shows the whole recording" in words
    words = refused("view", recording, "--png", tmp_path / "x.png", "--time", "7")
    assert "time 7 s is not in the recording, which spans 0 to 1.04" in words
    Recording({"contact_names": []}, {"t": np.zeros(1)}).save(tmp_path / "bare.npz")
    assert "does not hold the scenario" in refused("view", tmp_path / "bare.npz")
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "av", None)
        words = refused("view", recording, "--mp4", tmp_path / "x.mp4")
        assert "av is not installed: pip install 'osc-contact[video]'" in words
    monkeypatch.setenv("OSC_CONTACT_BROWSER", "/no/browser/here")
    assert "apt-get install chromium" in refused("view", recording, "--png", tmp_path / "x.png")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bare.npz"]

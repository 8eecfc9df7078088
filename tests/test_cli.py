"""The command line: what it prints, what it writes, how it exits."""

import io
import os
import shutil
import sys
from pathlib import Path
from unittest.mock import MagicMock

import numpy as np
import typer
from command_line import answered, call, done, read_json, refused
from PIL import Image
from processes import python
from pytest import approx, mark
from rigs import assert_near
from samples import ROOT, aligned, module_fixture, names_in, parametrize
from scenario_runs import run_of
from scene_samples import read_commands

import osc_contact
from osc_contact.lab.cli.app import app
from osc_contact.lab.cli.console import PARTIAL
from osc_contact.lab.plants.rigid import RigidPlant
from osc_contact.lab.visual import browser
from osc_contact.lab.visual.plots import PRINT
from osc_contact.recorder import Recording

ROD = "two_contact_rod --plant rigid --set 'plant.step=1 ms'"
SHORT = f"{ROD} --duration 1.05"
STARTS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


@module_fixture
def ran(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    return (folder, done(f"run {SHORT} --seed 7 --out {folder} --json {folder}/deep/again.json"))


def test_version_and_help():
    assert done("--version").stdout.strip() == f"osc-contact {osc_contact.__version__}"
    text = done("--help").stdout
    assert all(
        command in text for command in ["run", "reproduce", "view", "inspect", "list", "bench"]
    )
    first = done("").stdout
    assert "examples" in first and "--help" in first
    shown = [line.split()[1] for line in first.splitlines() if line.startswith("  osc-")]
    assert len(shown) == 5 and set(shown) <= set(typer.main.get_command(app).commands)


def test_examples_are_the_programs_of_the_docs(tmp_path):
    folder = tmp_path / "mine"
    printed = done("examples", folder).stdout
    files = sorted(folder.glob("*.py"))
    assert len(files) >= 10 and files[0].name == "01_first_program.py"
    assert files[0].read_text().split("\n", 2)[2] in (ROOT / "README.md").read_text()
    titles = [file.read_text().partition("\n")[0].removeprefix("# ") for file in files]
    assert len(set(titles)) == len(titles), "a program is chosen by its title"
    for file, title in aligned(files, titles):
        compile(file.read_text(), str(file), "exec")
        assert title in " ".join(printed.split()), "each file is listed with its title"
    copies = {path.stem for path in (folder / "scenarios").iterdir()}
    assert copies == set(osc_contact.list_scenarios())
    assert "is there already" in refused("examples", folder)


def test_list_names_scenarios():
    result, found = answered("list")
    assert "two_contact_rod" in result.stdout
    assert set(found["scenarios"]) == set(osc_contact.list_scenarios())


def test_inspect_prints_the_contact_state():
    result, found = answered("inspect two_contact_rod")
    assert (found["d"], found["r"], found["free_motions"]) == (5, 2, 3)
    assert all(sentence in result.stdout for sentence in found["lines"])
    assert f"{found['N'][0][0]:.4f}" in result.stdout, "the table shows N"


def test_run_leaves_everything_behind(ran):
    folder, result = ran
    names = names_in(folder)
    plots = ("contact_forces", "power", "tracking", "torques")
    figures = {f"{name}{suffix}" for name in plots for suffix in (".png", ".svg")}
    files = {"recording.npz", "recording.times.npz", "metrics.json", "scene.html", "deep"}
    assert names == figures | files | {"recording.events.jsonl"}
    for name in figures:
        content = (folder / name).read_bytes()
        assert content.startswith(STARTS[name[-4:]]) and len(content) > 5000
    paths = {command.get("path") for command in read_commands(folder / "scene.html")}
    assert "/meshcat/contacts/left_end/true" in " ".join(str(p) for p in paths)
    assert "\x1b" not in result.output and "━" not in result.stderr, "no progress when piped"
    assert str(folder) in result.stdout
    verdict = read_json(folder / "metrics.json")
    assert read_json(folder / "deep" / "again.json") == verdict
    about = [verdict[key] for key in ("scenario", "plant", "seed", "ticks", "duration_s")]
    assert about == ["two_contact_rod", "rigid", 7, 1050, approx(1.05)]
    assert all(force["rms_error_rel"] < 1e-3 for force in verdict["force"].values())
    recording = Recording.load(folder / "recording.npz")
    assert recording["tau"].shape == (1050, 8) and recording.meta["seed"] == 7
    assert osc_contact.metrics(recording)["ticks"] == 1050


def elsewhere(path, *words):
    """A command of the package as Python finds it on a path."""
    around = f"{path}{os.pathsep}{ROOT}"
    return python("-m", "osc_contact", *words, code=None, cwd=path, PYTHONPATH=around)


@parametrize("command, folder", {"reproduce": "paper", "bench": "benchmarks"})
def test_programs_of_the_checkout_are_missed_with_a_cure(command, folder, tmp_path):
    """As installed: another package of the name may be there, a checkout is not."""
    for part in ("osc_contact", "urdf"):
        shutil.copytree(ROOT / part, tmp_path / part)
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
        _, found = answered(f"reproduce {name} --out", tmp_path)
        assert (tmp_path / f"{name}.png").stat().st_size > 20000
        assert found["figures"] == [f"{tmp_path}/{name}{suffix}" for suffix in PRINT]
    assert not (tmp_path / "two_contact_rod").exists(), "no run was needed"


@mark.slow
def test_reproduce_all_from_a_short_run(tmp_path):
    options = SHORT.removeprefix("two_contact_rod")
    _, found = answered(f"reproduce all {options} --out", tmp_path)
    names = {*(f"fig{n}" for n in "1234568"), "kinematic_stability", "moving_face"}
    stems = {Path(file).stem for file in found["figures"] if file.endswith(".png")}
    assert names <= stems
    for stem in stems:
        for suffix in PRINT:
            content = (tmp_path / f"{stem}{suffix}").read_bytes()
            assert content.startswith(STARTS[suffix]) and len(content) > 5000
    for name in found["studies"]:
        assert (tmp_path / f"{name}.json").exists()
    assert read_json(tmp_path / "two_contact_rod" / "metrics.json")["ticks"] == 1050
    verdicts = {name: one["verdict"] for name, one in found["paper"].items()}
    assert "contradicted" not in verdicts.values()
    assert all(verdicts[name] == "reproduced" for name in ("fig1", "fig2", "fig4", "fig6", "fig8"))
    assert verdicts["fig5"] == "partly reproduced", "no force steps in this run"
    command = "osc-contact reproduce fig8 --plant rigid --duration 1.05 --set"
    assert command in (tmp_path / "report.html").read_text()


def test_bad_scenario_is_reported_with_its_line(tmp_path):
    source = osc_contact.load_scenario("two_contact_rod").source
    before = source.read_text().partition("squeeze:")[0]
    file = tmp_path / "bad.yaml"
    file.write_text(f"{before}squeeze: 10 mm")
    line = before.count("\n") + 1
    for command in ("inspect", "run --duration 1.05"):
        assert f"bad.yaml:{line}: squeeze" in refused(command, file)


@parametrize(
    "line, message",
    {
        "inspect two_contact_rob": "no packaged scenario 'two_contact_rob'",
        "reproduce fig9": "no figure 'fig9'; there are fig1",
        "reproduce fig2 --set 'squeeze=1 N'": "fig2 is not made from a scenario",
        "reproduce fig5 --samples 3": "leave --samples out",
        "reproduce fig2 --duration nan": "duration",
        "bench tock": "no benchmark 'tock'; there are tick, peers, ",
        "run two_contact_rod --set squeeze": "expected path.to.key=value",
        "run two_contact_rod --duration 0.9": "judged from t = 1 s",
        "run two_contact_rod --duration nan": "duration",
        "run two_contact_rod --plant gazebo": "gazebo",
        "run two_contact_rod --seed -1": "greater than or equal to 0",
        "run two_contact_rod_mismatch --plant rigid": "plant.type=mujoco",
        "run": "Missing argument",
        "bench tick --ticks 0": "greater than or equal to 1",
        "dance": "No such command",
    },
)
def test_bad_input_is_refused(line, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert message in refused(line)


def test_folder_that_cannot_be_written_is_refused_before_the_run(tmp_path):
    file = tmp_path / "file"
    file.touch()
    message = refused(f"run {SHORT} --out", file)
    assert "exists" in message and "file" in message


def test_failed_run_exits_with_1_and_keeps_what_was_recorded(ran, tmp_path, monkeypatch):
    command = RigidPlant.command

    def fragile(plant, tau, duration):
        if plant.time > 0.0195:
            raise osc_contact.PlantError("rigid plant diverged at t = 0.02 s")
        command(plant, tau, duration)

    monkeypatch.setattr(RigidPlant, "command", fragile)
    result = call(f"run {SHORT} --seed 7 --out", tmp_path)
    assert result.exit_code == 1 and "diverged at t = 0.02 s" in result.stderr
    assert str(tmp_path / PARTIAL) in result.stderr and "Traceback" not in result.output
    assert len(list(tmp_path.iterdir())) == 3, "and its times and events"
    part = Recording.load(tmp_path / PARTIAL)
    whole = Recording.load(ran[0] / "recording.npz")
    assert len(part) == 21 and part.channels.keys() == whole.channels.keys()
    for name in set(whole.channels) - {"tick_s"}:
        assert_near(part[name], whole[name][:21], atol=1e-13, name=name)


@parametrize(
    "package, extra, line",
    [
        ("matplotlib", "plot", "reproduce fig4"),
        ("matplotlib", "plot", f"run {SHORT}"),
        ("mujoco", "sim", "run two_contact_rod --duration 1.05"),
    ],
)
def test_missing_extra_is_named(package, extra, line, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    message = refused(f"{line} --out", tmp_path)
    assert f"{package} is not installed: pip install 'osc-contact[{extra}]'" in message
    assert not any(path.is_file() for path in tmp_path.rglob("*"))


def test_installed_command_pipes_and_exits_like_the_application(tmp_path):
    bad = elsewhere(tmp_path, "inspect", "nope")
    assert bad.returncode == 2 and bad.stdout == ""
    assert bad.stderr.startswith("error: no packaged scenario 'nope'")
    good = elsewhere(tmp_path, "list")
    assert good.returncode == 0 and good.stderr == "" and "\x1b" not in good.stdout + bad.stderr


# --- view -----------------------------------------------------------------------------------------


@module_fixture
def brief():
    return run_of("two_contact_rod", "plant.type=rigid", "plant.step=1 ms", duration=0.05)


def page_of(recording, folder, channels, **meta):
    """The command for it, with other channels and meta (None: left out) than the recording."""
    kept = {k: v for k, v in {**recording.channels, **channels}.items() if v is not None}
    file = Recording(recording.meta | meta, kept).save(folder / "bad.npz")
    return f"view {file} --html {folder / 'page.html'}"


#: What a page draws; of those without a mark it needs all.
NEEDED = ("t", "q", "pose")
DRAWN = (*NEEDED, "face_pose", "N", "contact_point", "contact_direction", "closed", "alpha_cmd")
DRAWN += ("alpha_meas", "alpha_true", "power_total", "power_projected")


@parametrize("name", DRAWN)
def test_view_refuses_channels_that_no_run_of_its_scenario_has(name, brief, tmp_path):
    def page(values):
        return page_of(brief, tmp_path, {name: values})

    ticks, *rest = brief[name].shape
    for shape in ((ticks, 0), (ticks, 3, 5), *([(ticks,)] if rest else [])):
        words = refused(page(np.zeros(shape)))
        assert f"channel '{name}' has shape {shape[1:]}" in words and f"{tuple(rest)}" in words
    assert f"channel '{name}' holds numbers above" in refused(page(np.full((ticks, *rest), 1e300)))
    if name in NEEDED:
        assert f"'{name}'" in refused(page(None))
    else:
        done(page(None))  # what is not there is not drawn


def test_view_refuses_the_wrong_times_and_meta(brief, tmp_path):
    for times in (np.zeros(50), np.arange(50.0)[::-1], np.full(50, np.nan), np.full(50, np.inf)):
        assert "channel 't'" in refused(page_of(brief, tmp_path, {"t": times}))
    for key, words in {
        "contact_names": "its contact_names are",
        "columns": "its columns are",
        "scenario": "does not hold the scenario",
    }.items():
        for junk in (5, "x", [], {}, ["a"], [7], {"a": 1}):
            assert words in refused(page_of(brief, tmp_path, {}, **{key: junk}))


def test_view_makes_the_page_of_a_contact_with_several_forces(tmp_path):
    path = run_of("ur5_wipe", duration=0.02).save(tmp_path / "run.npz")
    done("view", path, "--html", tmp_path / "page.html")


@parametrize("name", ["run.npz", "run.mcap"])
def test_view_refuses_files_that_are_no_recordings(name, tmp_path):
    page = tmp_path / "page.html"
    for content in (b"", b"name: two_contact_rod\n", b"\x89MCAP0\r\n" + bytes(range(256))):
        (tmp_path / name).write_bytes(content)
        words = refused("view", tmp_path / name, "--html", page)
        assert words.startswith("error: ") and name in words
    assert not page.exists()


@parametrize("first", [0, 20])
def test_view_draws_ticks_that_were_held_where_things_were_before(first, brief, tmp_path):
    gaps = {name: brief[name].astype(float) for name in DRAWN if name != "t"}
    for values in gaps.values():
        values[first : first + 25] = np.nan
    done(page_of(brief, tmp_path, gaps))


def test_view_makes_the_page_of_a_recording(ran, brief, tmp_path):
    page = tmp_path / "deep" / "page.html"
    result = done("view", ran[0] / "recording.npz", "--html", page, "--time", "0.5")
    assert f"written: {page}" in result.stdout.replace("\n", "")
    assert '"still": 0.5' in page.read_text()
    moved, of_the_run = (
        [c for c in read_commands(file) if c["type"] != "set_object"]
        for file in (page, ran[0] / "scene.html")
    )
    assert moved == of_the_run
    short = Recording(brief.meta, brief.rows(0, 3)).save(tmp_path / "short.npz")
    done("view", short, "--html", page)  # shorter than a picture


def test_the_folder_of_a_run_stands_for_its_recording(ran, tmp_path):
    page = tmp_path / "page.html"
    done("view", ran[0], "--html", page, "--time", "0.5")
    assert "left_end" in page.read_text()
    done("export", ran[0], tmp_path / "run.csv")
    assert (tmp_path / "run.csv").read_text().startswith("t,")
    bare = tmp_path / "bare"
    bare.mkdir()
    for line in (("view", bare), ("export", bare, tmp_path / "run.csv")):
        assert "there is no recording.npz, recording_until_failure.npz or unf" in refused(*line)


def test_view_runs_a_scenario_and_writes_to_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done(f"view {ROD} --duration 0.05")
    assert names_in(tmp_path / "out") == {"two_contact_rod.html"}
    done(f"view {ROD} --duration 0.05 --png new.png --time 0.02")
    assert Path("new.png").read_bytes().startswith(STARTS[".png"])
    grey = io.BytesIO()
    Image.new("RGB", browser.SIZE).save(grey, "PNG")
    chromium = MagicMock()  # tests/test_browser.py makes moving pictures with Chromium
    chromium.return_value.__enter__.return_value.png.return_value = grey.getvalue()
    monkeypatch.setattr(browser, "Browser", chromium)
    for kind, start in (("gif", b"GIF89a"), ("mp4", b"\0\0\0 ftyp")):
        done(f"view {ROD} --duration 0.05 --{kind} new.{kind}")
        assert Path(f"new.{kind}").read_bytes().startswith(start)


@parametrize("what", ["scenario", "recording"])
def test_view_live_serves_a_page_while_it_runs(what, brief, tmp_path):
    file = brief.save(tmp_path / "short.npz")
    line = f"view {ROD} --duration 0.1" if what == "scenario" else f"view {file}"
    assert done(f"{line} --live --hold 0.1").stdout.startswith("open http://127.0.0.1:")


def test_view_refuses_what_it_cannot_show(ran, tmp_path, monkeypatch):
    recording = ran[0] / "recording.npz"
    bare = Recording({"contact_names": []}, {"t": np.zeros(1)}).save(tmp_path / "bare.npz")
    for line, words in {
        "--live --html x.html": "give one of",
        "--duration 1": "change scenarios, not recordings",
        "--gif x.gif --time 0.5": "a GIF shows the whole recording",
        "--mp4 x.mp4 --time 0.5": "a video shows the whole recording",
        "--png x.png --time 7": "time 7 s is not in the recording, which spans 0 to 1.04",
    }.items():
        assert words in refused(f"view {recording} {line}")
    assert "no recording" in refused("view none.npz")
    assert "does not hold the scenario" in refused("view", bare)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "av", None)
        words = refused(f"view {recording} --mp4", tmp_path / "x.mp4")
        assert "av is not installed: pip install 'osc-contact[video]'" in words
    monkeypatch.setenv("OSC_CONTACT_BROWSER", "/no/browser/here")
    assert "apt-get install chromium" in refused(f"view {recording} --png", tmp_path / "x.png")
    assert names_in(tmp_path) == {"bare.npz"}

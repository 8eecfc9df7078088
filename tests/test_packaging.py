"""Installed package: content of the wheel, pinned versions, files of the root folder."""

import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from processes import python
from samples import ROOT, module_fixture, parametrize

from hatch_build import absolute
from osc_contact.control import web_assembly
from osc_contact.lab.cli.app import PAGES
from osc_contact.law import jit, library


def text_of(name):
    return (ROOT / name).read_text()


def yaml_of(name):
    return yaml.safe_load(text_of(name))


SETTINGS = tomllib.loads(text_of("pyproject.toml"))
PROJECT = SETTINGS["project"]
ELSEWHERE = ("mutation", "robosuite", "drake")  #: extras that no other environment has
EXTRAS = [name for name in PROJECT["optional-dependencies"] if name not in ELSEWHERE]


def wheel_of(source, folder):
    options = ("--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check")
    python("-m", "pip", "wheel", *options, "-w", folder, source, cwd=folder)
    (wheel,) = folder.glob("*.whl")
    return zipfile.ZipFile(wheel)


@module_fixture
def wheel(tmp_path_factory):
    with wheel_of(ROOT, tmp_path_factory.mktemp("wheel")) as archive:
        yield archive


def requirements(*extras):
    texts = list(PROJECT["dependencies"])
    for extra in extras:
        texts += PROJECT["optional-dependencies"][extra]
    return [r for r in map(Requirement, texts) if r.name != PROJECT["name"]]


def constraints():
    lines = text_of("constraints.txt").splitlines()
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[A-Za-z0-9.+!]+", line) for line in lines)
    assert lines == sorted(lines, key=str.lower)
    return {canonicalize_name(name): version for name, version in (x.split("==") for x in lines)}


@parametrize(
    "pattern",
    [
        "urdf/*.urdf",
        "osc_contact/lab/scenarios/files/*.yaml",
        "osc_contact/**/*.py",
        "osc_contact/py.typed",
        "osc_contact/lab/visual/assets/*",
        "docs/own_loop.md",
    ],
)
def test_wheel_carries(wheel, pattern):
    files = [*ROOT.glob(pattern)]
    assert files
    for file in files:
        name = file.relative_to(ROOT).as_posix().removeprefix("osc_contact/")
        assert wheel.read(f"osc_contact/{name}") == file.read_bytes()


def test_wheel_carries_the_pages_whose_programs_are_written(wheel):
    carried = {name for name in wheel.namelist() if name.startswith("osc_contact/docs/")}
    assert carried == {f"osc_contact/docs/{page}" for page in PAGES}


def test_wheel_carries_nothing_else(wheel):
    tops = {name.split("/")[0] for name in wheel.namelist()}
    assert tops == {"osc_contact", f"osc_contact-{PROJECT['version']}.dist-info"}
    assert not [name for name in wheel.namelist() if "__pycache__" in name]


def test_wheel_declares_the_command_and_the_licence(wheel):
    info = f"osc_contact-{PROJECT['version']}.dist-info"
    assert wheel.read(f"{info}/licenses/LICENSE") == (ROOT / "LICENSE").read_bytes()
    for words, name in {
        b"osc-contact = osc_contact.__main__:main": "entry_points.txt",
        b"License-Expression: BSD-3-Clause\n": "METADATA",
        b"Requires-Python: >=3.11\n": "METADATA",
    }.items():
        assert words in wheel.read(f"{info}/{name}")


def test_source_archive_builds_the_same_wheel(wheel, tmp_path, monkeypatch):
    monkeypatch.setenv("OSC_CONTACT_LAW", "jit")  # a wheel for every platform
    python("-m", "hatchling", "build", "-t", "sdist", "-d", tmp_path / "sdist", cwd=ROOT)
    (sdist,) = (tmp_path / "sdist").glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        inside = {name.split("/", 1)[1] for name in archive.getnames()}
    for file in ("constraints.txt", "CHANGELOG.md", "CITATION.cff", "Makefile", "urdf/rod.urdf"):
        assert file in inside
    assert f"tests/{Path(__file__).name}" in inside
    (tmp_path / "wheel").mkdir()
    with wheel_of(sdist, tmp_path / "wheel") as second:
        names = (library.LIBRARY, library.OBJECT, web_assembly.MODULE)
        law = {f"osc_contact/law/{name}" for name in names}
        assert (law <= set(wheel.namelist())) == jit.HAS_LIBRARY
        assert set(second.namelist()) == set(wheel.namelist()) - law


def test_constraints_satisfy_every_bound():
    pinned = constraints()
    for requirement in requirements(*EXTRAS):
        version = pinned.get(canonicalize_name(requirement.name))
        assert version is not None, f"{requirement} is not in constraints.txt"
        assert requirement.specifier.contains(version), f"{requirement}, but {version} is pinned"


CONDA_NAMES = {
    "pin": "pinocchio",
    "meshcat": "meshcat-python",
    "mujoco": "mujoco-python",
    "matplotlib": "matplotlib-base",
}


def test_conda_recipe_requires_what_the_wheel_requires():
    recipe = yaml_of("conda/recipe.yaml")
    assert recipe["context"]["version"] == PROJECT["version"]
    assert f">={recipe['context']['python_min']}" == PROJECT["requires-python"]
    (command,) = recipe["build"]["python"]["entry_points"]
    assert dict([command.split(" = ")]) == PROJECT["scripts"]
    listed = recipe["requirements"]
    further = [r for r in requirements("sweep", "tune", "learn") if r not in requirements()]
    of_python = {"python >=${{ python_min }}", "__linux"}
    for part, expected in (
        (set(listed["run"]) - of_python, requirements("law", "scenarios", "view", "sim", "plot")),
        (listed["run_constraints"], further),
    ):
        names = {r.name: CONDA_NAMES.get(r.name, r.name.lower()) for r in expected}
        bounds = {names[r.name]: r.specifier for r in expected}
        assert {r.name: r.specifier for r in map(Requirement, part)} == bounds


def test_every_requirement_is_bounded_on_both_sides():
    build = SETTINGS["build-system"]["requires"]
    for requirement in [*requirements(*EXTRAS), *map(Requirement, build)]:
        operators = {specifier.operator for specifier in requirement.specifier}
        assert operators == {">=", "<"}, f"{requirement} has no lower or no upper bound"


def test_citation_names_the_software_and_the_paper():
    citation = yaml_of("CITATION.cff")
    about = {"cff-version": "1.2.0", "type": "software", "license": PROJECT["license"]}
    assert about.items() <= citation.items()
    assert str(citation["version"]) == PROJECT["version"]
    (paper,) = (r for r in citation["references"] if r["type"] == "conference-paper")
    assert paper["title"].startswith("A General Contact Model for Dynamically-Decoupled")
    families = [author["family-names"] for author in paper["authors"]]
    assert families == ["Featherstone", "Sonti Thiebaut", "Khatib"]
    assert {"year": 1999, "start": 3281, "end": 3286}.items() <= paper.items()


def test_changelog_names_this_version():
    assert f"## [{PROJECT['version']}]" in text_of("CHANGELOG.md")


def test_make_has_the_targets_that_pages_and_workflows_name():
    pages = [*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob(".github/workflows/*.yml")]
    text = "\n".join(page.read_text() for page in [*pages, ROOT / "pixi.toml"])
    named = set(re.findall(r'(?:^|[`"]|run: )make ([\w-]+)', text, re.M))
    assert {"demo", "gallery", "peers", "oldest-numba"} < named
    assert named - set(re.findall(r"^([\w-]+):", text_of("Makefile"), re.M)) == set()


def test_the_demo_shows_its_task_before_it_waits_for_anything():
    (recipe,) = re.findall(r"^demo:\n((?:\t.*\n)+)", text_of("Makefile"), re.M)
    steps = [recipe.index(step) for step in ("$(chromium)", " run two_contact_rod", "look at out")]
    later = [recipe.index(step) for step in ("wait $$chromium", "reproduce all")]
    assert steps == sorted(steps) and later == sorted(later) and steps[-1] < later[0]
    assert recipe.index("& chromium=$$!") < steps[1], "it is installed beside the rest"


def test_what_takes_minutes_in_silence_is_announced_with_its_time():
    makefile = text_of("Makefile")
    installing = [block for block in makefile.split("\n\n") if "\t@touch $@" in block]
    assert len(installing) == 3, "of demo and tests, of the peers, of robosuite and Drake"
    for recipe in installing:
        words = recipe.index('@echo "installing')
        begins = re.search("/pip install|call install", recipe)
        assert begins and words < begins.start(), recipe
        assert "minutes" in recipe[words : recipe.index("\n", words)], recipe
    (demo,) = re.findall(r"^demo:\n((?:\t.*\n)+)", makefile, re.M)
    for step, time in (("osc-contact run", "seconds"), ("reproduce all", "minutes")):
        assert time in demo[: demo.index(step)].rpartition("echo ")[2], step


def make_with_stand_ins(folder, *targets, worlds=("robosuite", "drake", "taskboard")):
    """Run the Makefile where worlds have Pythons that print their arguments; judges exit with 1."""
    for name in ("Makefile", "pyproject.toml", *(f.name for f in ROOT.glob("constraints-*.txt"))):
        (folder / name).write_text(text_of(name))
    for world in worlds:
        program = folder / f".venv-{world}/bin/python"
        program.parent.mkdir(parents=True)
        program.write_text('#!/bin/sh\necho "> $*"\ncase "$*" in *two_judges*) exit 1;; esac\n')
        program.chmod(0o755)
        (folder / f".venv-{world}/.installed").touch()
    return subprocess.run(
        ["make", *targets],
        cwd=folder,
        env={"PATH": os.environ["PATH"]},
        capture_output=True,
        text=True,
        timeout=120,
    )


@parametrize("worlds", [(), ("drake", "taskboard")])
def test_worlds_that_are_installed_are_tested_with_the_rest(worlds, tmp_path):
    done = make_with_stand_ins(tmp_path, "test-worlds", worlds=worlds)
    ran = [line.split()[-1] for line in done.stdout.splitlines() if line.startswith("> ")]
    assert ran == [f"tests/try_{world}.py" for world in worlds] and not done.returncode
    (recipe,) = re.findall(r"^test: .*\n((?:\t.*\n)+)", text_of("Makefile"), re.M)
    assert recipe.splitlines()[-1].endswith(" test-worlds")


@parametrize("options", [[], ["FULL=1", "WORKERS=5"]])
def test_worlds_goes_on_after_a_step_that_fails_and_says_all_times(options, tmp_path):
    """A missed limit of the judges, their exit code 1, must not cost the hours of the pegs."""
    done = make_with_stand_ins(tmp_path, "worlds", *options)
    ran = [line for line in done.stdout.splitlines() if line.startswith("> ")]
    numbers = "--full --workers 5" if options else "--seeds 3 --workers 2"
    judges = "--workers 5" if options else "--duration 4 --workers 2"
    assert [line.split("benchmarks.")[1] for line in ran if "benchmarks" in line] == [
        f"wiping {numbers}",
        f"two_judges {judges}",
        f"taskboard {numbers}",
    ]
    assert [line.split()[-1] for line in ran if "pytest" in line] == [
        f"tests/try_{world}.py" for world in ("robosuite", "drake", "taskboard")
    ]
    took = re.findall("^(?:all steps )?took .*m.*s, processors .*s$", done.stderr, re.M)
    assert len(took) == len(ran) + 1 and took[-1].startswith("all steps")
    assert done.returncode and re.findall("^failed: .*benchmarks.(.*)", done.stdout, re.M) == [
        f"two_judges {judges}"
    ]


def test_a_browser_is_looked_for_without_any_package(tmp_path):
    program = [sys.executable, "-S", "-m", "osc_contact.lab.visual.browser"]
    nothing = {"PATH": str(tmp_path), "PYTHONPATH": str(ROOT)}
    found = subprocess.run(program, capture_output=True, text=True, env=nothing, timeout=120)
    assert found.returncode == 1 and "apt-get install chromium" in found.stderr, found.stderr


def test_the_paper_has_the_sections_of_the_journal_and_cites_what_it_lists():
    _, front, text = text_of("paper/joss/paper.md").split("---\n", 2)
    front = yaml.safe_load(front)
    assert {"title", "tags", "authors", "affiliations", "date", "bibliography"} <= set(front)
    assert re.findall(r"^# (.*)$", text, re.MULTILINE) == [
        "Summary",
        "Statement of need",
        "State of the field",
        "Software design",
        "Research impact statement",
        "AI usage disclosure",
        "References",
    ]
    listed = re.findall(r"^@\w+\{([^,]+),", text_of("paper/joss/paper.bib"), re.MULTILINE)
    assert set(re.findall(r"@([A-Z]\w+(?::\d+)?)", text)) == set(listed)
    assert 250 <= len(text.split()) <= 1750


def test_issue_templates_ask_for_something():
    forms = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
    assert len(forms) == 3
    for form in map(yaml_of, forms):
        assert form.get("blank_issues_enabled") or (form["name"] and form["body"])


def test_the_readme_leads_somewhere_once_there_is_an_address():
    linked = absolute(text_of("README.md"), "https://example.org/o/r")
    targets = re.findall(r"\]\(([^)]+)\)", linked)
    assert targets and all(re.match(r"https?://|#", target) for target in targets)
    picture = "docs/images/two_contact_rod.gif"
    assert f"](https://example.org/o/r/raw/main/{picture})" in linked
    assert "](https://example.org/o/r/blob/main/CONTRIBUTING.md)" in linked


def test_only_the_job_that_publishes_may_prove_who_it_is():
    text = text_of(".github/workflows/publish.yml")
    jobs = yaml.safe_load(text)["jobs"]
    assert [n for n, job in jobs.items() if "id-token" in job.get("permissions", {})] == ["publish"]
    assert "password" not in text.split("\n", 1)[1] and jobs["publish"]["needs"] == "build"


def test_commits_are_checked_as_make_check_does():
    repos = yaml_of(".pre-commit-config.yaml")["repos"]
    commands = [hook["entry"] for repo in repos for hook in repo["hooks"]]
    makefile = text_of("Makefile")
    (names,) = re.findall(r"^CHECKS := (.*)$", makefile, re.M)
    recipes = [re.findall(rf"^{name}:\n\t(.*\n)(?!\t)", makefile, re.M) for name in names.split()]
    made = [recipe.strip().replace("$(BIN)", ".venv/bin") for (recipe,) in recipes]
    assert commands == [line.removesuffix(" .") for line in made]

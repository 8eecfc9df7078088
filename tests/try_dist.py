"""`make dist`: wheel and sdist, each tried in an empty environment outside of the checkout.

    python tests/try_dist.py DIST [--versions pinned|lowest|highest] [PYTHON ...]
    python tests/try_dist.py --suite [--versions …] [PYTHON ...]        (`make versions`)

Installs what lies in DIST with its extras, then runs what a new user runs, in a separate folder;
the wheel also without extras, and beside the packages of `BESIDE` as far as pip resolves them. With
--suite it runs the tests of the checkout in an environment beside it. Versions of the dependencies:
those of constraints.txt, the lower bounds of pyproject.toml, or the highest that the bounds allow.
"""

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parent.parent
PICTURE = (  # with the first compilation in it
    "osc-contact run two_contact_rod --duration 2 --out rod",
    "osc-contact view rod/recording.npz --gif rod.gif",
)
COMMANDS = (
    "osc-contact",
    "osc-contact list",
    "osc-contact examples mine",
    "python mine/01_first_program.py",
)
TESTS = ("test_contact.py", "test_projections.py", "test_importing.py", "test_browser.py")
BESIDE = ("franky-sim", "robosuite", "mjlab", "newton")
#: Tests with tools of `docs` and `dev`, which need newer versions of what the package needs, too.
OF_PAGES = ("test_site.py", "test_types.py")
OTHERS_WARN = ("optuna.exceptions.ExperimentalWarning",)  # of what is an argument of optuna 5
#: Tests of what differs with versions: layers need a tool of `dev`, robots come and go.
OF_PINNED = "not picture_of_the_rooms and not every_robot_of_the_data"
OF_NEWER = "not vector_env and not learning.md and not even_force and not best_forces"  # MuJoCo 4
WRITTEN = ("rod/metrics.json", "rod/scene.html", "rod.gif")


def main():
    """Try every file of the folder with every Python, or run the tests with each."""
    ask = argparse.ArgumentParser()
    ask.add_argument("--suite", action="store_true")
    ask.add_argument("--versions", choices=("pinned", "lowest", "highest"), default="pinned")
    ask.add_argument("given", nargs="*")
    options = ask.parse_intermixed_args()  # Pythons may come after options
    if options.suite:
        for python in options.given or [sys.executable]:
            suite(python, options.versions)
        return
    dist, *pythons = options.given
    for python in pythons or [sys.executable]:
        for file in sorted([*Path(dist).glob("*.whl"), *Path(dist).glob("*.tar.gz")]):
            if file.suffix == ".whl":
                core(file.resolve(), python)
                beside(file.resolve(), python)
            attempt(file.resolve(), python, options.versions)


def say(words):
    print(words, flush=True)


def lowest():
    """The lower bound of every dependency, as pip's constraints."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    users = [*project["dependencies"]]
    for extra, listed in project["optional-dependencies"].items():
        others = ("all", "docs", "test", "dev", "mutation", "robosuite", "drake")
        users += listed if extra not in others else []
    # matplotlib 3.10 calls what later versions of pyparsing warn of
    return ["pyparsing<3.3", *(re.sub(r">=([^,]+),.*", r"==\1", one) for one in users)]


def limits(folder, versions):
    """pip's options that choose the versions."""
    if versions == "pinned":
        return ("-c", str(ROOT / "constraints.txt"))
    bounds = folder / "bounds.txt"
    bounds.write_text("\n".join(lowest() if versions == "lowest" else []))
    return ("-c", str(bounds))


def environment(folder, python, name="env"):
    """A new one: the variables of its commands, and its pip."""
    run(folder, {}, python, "-m", "venv", "--clear", name)
    around = {
        "PATH": f"{folder / name / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "NUMBA_CACHE_DIR": str(folder / name / "compiled"),
    }
    return (around, (str(folder / name / "bin/python"), "-m", "pip", "install", "-q"))


def suite(python, versions):
    """The tests of the checkout, with the library of the law that the environment's numba makes."""
    name = f".venv-{versions}"
    around, pip = environment(ROOT, python, name)
    run(ROOT, around, *pip, *limits(ROOT / name, versions), "-e", f"{ROOT}[test]")
    around |= {"OSC_CONTACT_LAW": "", "OSC_CONTACT_CACHE": str(ROOT / name / "cache")}
    around["PYTHONDONTWRITEBYTECODE"] = "1"
    run(ROOT, around, "python", "-m", "osc_contact.law.c_object")
    others = [f"--ignore=tests/{test}" for test in OF_PAGES]
    warned = (f"-Wignore::{one}" for one in ("DeprecationWarning", *OTHERS_WARN))
    how = ("-q", "-n", "auto", "-p", "no:cacheprovider", *warned)
    leave = {"pinned": "", "highest": OF_PINNED, "lowest": f"{OF_PINNED} and {OF_NEWER}"}
    others += ["-k", leave[versions]]
    done = subprocess.run(
        [str(ROOT / name / "bin/python"), "-m", "pytest", *how, "-m", "not slow", *others],
        cwd=ROOT,
        env=os.environ | around,
    )
    if done.returncode:
        sys.exit(f"the tests fail with {versions} versions")


def core(file, python):
    """Modules of Pinocchio alone and those added by the wheel; its loop runs without extras."""
    with tempfile.TemporaryDirectory(prefix="osc_contact_core_") as name:
        folder = Path(name)
        around, pip = environment(folder, python)
        empty = size(folder)
        run(folder, around, *pip, "pin")
        before = size(folder)
        run(folder, around, *pip, str(file))
        after = size(folder)
        run(folder, around, *pip, "--no-deps", "example-robot-data")  # the robot of the program
        page = (ROOT / "docs/own_loop.md").read_text()
        run(folder, around, "python", "-c", page.split("```python\n")[1].split("```")[0])
    for what, found in (("pin", before), (f"{file.name}, no extras", after)):
        packages, size_of = (x - y for x, y in zip(found, empty, strict=True))
        say(f"  {what}: {packages} packages, {size_of / 1e6:.0f} MB")


def size(folder):
    """Packages of the environment, and its bytes."""
    site = next((folder / "env/lib").glob("python*/site-packages"))
    files = (path for path in (folder / "env").rglob("*") if path.is_file())
    return (len([*site.glob("*.dist-info")]), sum(path.lstat().st_size for path in files))


def beside(file, python):
    """Versions that pip selects for the package with all extras beside other packages."""
    with tempfile.TemporaryDirectory(prefix="osc_contact_beside_") as name:
        folder = Path(name)
        around, pip = environment(folder, python)
        torch = folder / "torch.txt"  # mjlab needs it: one version, not all of them
        pinned = (ROOT / "constraints-peers.txt").read_text()
        torch.write_text(re.search(r"^torch==.*$", pinned, re.M)[0])
        for other in BESIDE:
            report = folder / f"{other}.json"
            options = ("--dry-run", "--report", str(report), "-c", str(torch))
            run(folder, around, *pip, *options, f"{file}[all]", other)
            found = {
                item["metadata"]["name"].lower(): item["metadata"]["version"]
                for item in json.loads(report.read_text())["install"]
            }
            shown = ", ".join(f"{n} {found[n]}" for n in (other, "numpy", "pin", "mujoco"))
            say(f"  beside {other}: {shown}")


def attempt(file, python, versions):
    """Install one file into an empty environment and use it; exits where a command fails."""
    with tempfile.TemporaryDirectory(prefix="osc_contact_dist_") as name:
        folder = Path(name)
        say(f"{file.name} with {python}, {versions} versions, in {folder}")
        begin = perf_counter()
        around, pip = environment(folder, python)
        run(folder, around, *pip, *limits(folder, versions), f"{file}[all]")
        installed = perf_counter()
        for command in PICTURE:
            run(folder, around, *command.split())
        seen = perf_counter()
        say(
            f"  a moving picture {seen - installed:.0f} s after the package was installed, "
            f"{seen - begin:.0f} s after there was nothing"
        )
        for command in COMMANDS:
            run(folder, around, *command.split())
        missing = [path for path in WRITTEN if not (folder / path).is_file()]
        if missing:
            sys.exit(f"not written: {', '.join(missing)}")
        if file.name.endswith(".tar.gz"):
            shutil.unpack_archive(file, folder, filter="data")
            (source,) = folder.glob("osc_contact-*")
            run(
                source,
                around,
                *["python", "-m", "osc_contact", "reproduce", "fig1", "--out", "figures"],
            )
            if not (source / "figures/fig1.png").is_file():
                sys.exit("the source archive makes no figure")
        for needed in ("tests", "urdf"):
            shutil.copytree(ROOT / needed, folder / needed)
        run(folder, around, *pip, "pytest", "pytest-timeout", "hypothesis")
        tests = [f"tests/{test}" for test in TESTS]
        run(folder, around, "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests)


def run(folder, around, *command):
    """Run a command in the folder, tell how long it took; exit where it fails."""
    begin = perf_counter()
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | around
    program = shutil.which(command[0], path=environment["PATH"]) or command[0]
    done = subprocess.run(
        [program, *command[1:]], cwd=folder, env=environment, capture_output=True, text=True
    )
    shown = " ".join(Path(command[0]).name if k == 0 else word for k, word in enumerate(command))
    say(f"  {perf_counter() - begin:6.1f} s  {' '.join(shown.split())[:90]}")
    if done.returncode:
        sys.exit(f"{done.stdout}\n{done.stderr}\nexit code {done.returncode}: {shown}")


if __name__ == "__main__":
    main()

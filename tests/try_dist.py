"""`make dist`: wheel and sdist, each tried in an empty environment outside of the checkout.

    python tests/try_dist.py DIST [--versions pinned|lowest|highest] [PYTHON ...]

Installs what lies in DIST with its extras, then runs what a new user runs, in a folder of its own.
Versions of the dependencies: those of constraints.txt, the lower bounds of pyproject.toml, or the
highest that the bounds allow.
"""

import argparse
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
    ("osc-contact", "run", "two_contact_rod", "--duration", "2", "--out", "rod"),
    ("osc-contact", "view", "rod/recording.npz", "--gif", "rod.gif"),
)
COMMANDS = (
    ("osc-contact",),
    ("osc-contact", "list"),
    ("osc-contact", "examples", "mine"),
    ("python", "mine/01_osc_contact.py"),
)
TESTS = ("test_contact.py", "test_projections.py", "test_importing.py", "test_movie.py")
WRITTEN = ("rod/metrics.json", "rod/scene.html", "rod.gif")


def main():
    """Try every file of the folder with every Python."""
    ask = argparse.ArgumentParser()
    ask.add_argument("dist", type=Path)
    ask.add_argument("pythons", nargs="*", default=[sys.executable])
    ask.add_argument("--versions", choices=("pinned", "lowest", "highest"), default="pinned")
    asked = ask.parse_intermixed_args()  # Pythons may come after options
    for python in asked.pythons:
        for file in sorted([*asked.dist.glob("*.whl"), *asked.dist.glob("*.tar.gz")]):
            attempt(file.resolve(), python, asked.versions)


def lowest():
    """The lower bound of every dependency, as pip's constraints."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    users = [*project["dependencies"]]
    for extra, listed in project["optional-dependencies"].items():
        users += listed if extra not in ("all", "docs", "dev", "mutation") else []
    return [re.sub(r">=([^,]+),.*", r"==\1", requirement) for requirement in users]


def attempt(file, python, versions):
    """Install one file into an empty environment and use it; exits where a command fails."""
    with tempfile.TemporaryDirectory(prefix="osc_contact_dist_") as name:
        folder = Path(name)
        print(f"{file.name} with {python}, {versions} versions, in {folder}", flush=True)
        begin = perf_counter()
        run(folder, {}, python, "-m", "venv", "env")
        around = {
            "PATH": f"{folder / 'env/bin'}{os.pathsep}{os.environ['PATH']}",
            "NUMBA_CACHE_DIR": str(folder / "compiled"),
        }
        pip = (str(folder / "env/bin/python"), "-m", "pip", "install", "-q")
        bounds = folder / "bounds.txt"
        bounds.write_text("\n".join(lowest() if versions == "lowest" else []), encoding="utf-8")
        limits = ("-c", str(ROOT / "constraints.txt" if versions == "pinned" else bounds))
        run(folder, around, *pip, *limits, f"{file}[all]")
        installed = perf_counter()
        for command in PICTURE:
            run(folder, around, *command)
        seen = perf_counter()
        print(
            f"  a moving picture {seen - installed:.0f} s after the package was installed, "
            f"{seen - begin:.0f} s after there was nothing",
            flush=True,
        )
        for command in COMMANDS:
            run(folder, around, *command)
        missing = [path for path in WRITTEN if not (folder / path).is_file()]
        if missing:
            sys.exit(f"not written: {', '.join(missing)}")
        if file.name.endswith(".tar.gz"):
            shutil.unpack_archive(file, folder, filter="data")
            (source,) = folder.glob("osc_contact-*")
            run(
                source,
                around,
                "python",
                "-m",
                "osc_contact",
                "reproduce",
                "fig1",
                "--out",
                "figures",
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
    print(f"  {perf_counter() - begin:6.1f} s  {shown[:90]}", flush=True)
    if done.returncode:
        sys.exit(f"{done.stdout}\n{done.stderr}\nexit code {done.returncode}: {shown}")


if __name__ == "__main__":
    main()

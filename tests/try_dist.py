"""`make dist`: wheel and sdist, each tried in an empty environment outside of the checkout.

    python tests/try_dist.py DIST [PYTHON ...]

Installs what lies in DIST with its extras, then runs what a new user runs, in a folder of its own.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parent.parent
TASK = ("osc-contact", "run", "two_contact_rod", "--duration", "2", "--out", "rod")
COMMANDS = (
    ("osc-contact",),
    ("osc-contact", "list"),
    TASK,
    ("osc-contact", "view", "rod/recording.npz", "--gif", "rod.gif"),
    ("osc-contact", "reproduce", "fig1", "--out", "figures"),
    ("osc-contact", "examples", "mine"),
    ("python", "mine/01_osc_contact.py"),
)
TESTS = ("test_contact.py", "test_projections.py", "test_importing.py", "test_movie.py")
WRITTEN = ("rod/metrics.json", "rod/scene.html", "rod.gif", "figures/fig1.png")


def main() -> None:
    """Try every file of the folder with every Python."""
    dist, pythons = Path(sys.argv[1]).resolve(), sys.argv[2:] or [sys.executable]
    for python in pythons:
        for file in sorted([*dist.glob("*.whl"), *dist.glob("*.tar.gz")]):
            attempt(file, python)


def attempt(file: Path, python: str) -> None:
    """Install one file into an empty environment and use it; exits where a command fails."""
    with tempfile.TemporaryDirectory(prefix="osc_contact_dist_") as name:
        folder = Path(name)
        print(f"{file.name} with {python}, in {folder}", flush=True)
        run(folder, {}, python, "-m", "venv", "env")
        around = {
            "PATH": f"{folder / 'env/bin'}{os.pathsep}{os.environ['PATH']}",
            "NUMBA_CACHE_DIR": str(folder / "compiled"),
        }
        pip = (str(folder / "env/bin/python"), "-m", "pip", "install", "-q")
        pinned = ("-c", str(ROOT / "constraints.txt"))
        run(folder, around, *pip, *pinned, f"{file}[all]", "pytest", "pytest-timeout", "hypothesis")
        begin = perf_counter()
        for command in COMMANDS:
            run(folder, around, *command)
            if "--gif" in command:
                print(
                    f"  from the first command to a moving picture: {perf_counter() - begin:.0f} s"
                )
        missing = [path for path in WRITTEN if not (folder / path).is_file()]
        if missing:
            sys.exit(f"not written: {', '.join(missing)}")
        for needed in ("tests", "urdf"):
            shutil.copytree(ROOT / needed, folder / needed)
        tests = [f"tests/{test}" for test in TESTS]
        run(folder, around, "python", "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests)


def run(folder: Path, around: dict[str, str], *command: str) -> None:
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

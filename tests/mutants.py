"""Small faults put into the law, one at a time: how many of them do the tests notice?

    python tests/mutants.py [--count 300] [--seed 1] [--only TEXT] [--again] [--out out/mutants]

Works in a copy of the checkout, without compilation. First every judge (a test file that is fast
that way) is run once, with the lines that each of its tests runs. Then places are drawn at random,
a mutant at each; the tests that run its line judge it, the shortest first, until one fails or
those that take `--budget` seconds have passed. Mutants are cosmic-ray's; left out are those that
every run notices (operators that floats do not have) and none can (decorators, annotations).
Results are kept: the same command goes on where it was, `--again` judges survivors once more.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as xml
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from cosmic_ray.commands.init import _all_work_items
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_item import MutationSpec
from coverage import CoverageData

ROOT = Path(__file__).resolve().parent.parent
#: How the law is compiled is not the law: these lines do not run without compilation.
LEFT_OUT = ("__init__.py", "accelerator.py", "compiled.py", "jit.py")
MODULES = ("projections.py", "spans.py", "response.py", "control/monitor.py")
JUDGES = (
    "law_once", "projections", "spans", "monitor", "law_limits", "law_phases", "law_linkage",
    "robot_limits", "safety", "lying_sensors", "force_filter", "singular", "effort_limits",
    "reading", "contact_phases", "allocation", "joint_limits", "idle_motions", "gains",
)  # fmt: skip
SLOW = 20  #: s; a test that takes longer without compilation is no judge
OPERATORS = re.compile(
    r"""core/(ReplaceBinaryOperator_(Add_Sub|Add_Mul|Sub_Add|Mul_Div|Mul_Add|Div_Mul|Pow_Mul
        |Mod_FloorDiv|FloorDiv_Mul)|ReplaceComparisonOperator_(?!Is)\w+(?<!Is)(?<!IsNot)
        |ReplaceUnaryOperator_(USub_UAdd|Delete_Not)|AddNot|ReplaceTrueWithFalse
        |ReplaceFalseWithTrue|ReplaceAndWithOr|ReplaceOrWithAnd|ReplaceBreakWithContinue
        |ReplaceContinueWithBreak|NumberReplacer|ZeroIterationForLoop)$""",
    re.VERBOSE,
)


def main() -> None:
    """Draw, judge, count."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--count", type=int, default=300, help="mutants")
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--only", default="", help="modules whose path holds this text")
    ask.add_argument("--again", action="store_true", help="judge survivors once more")
    ask.add_argument("--budget", type=float, default=40.0, help="s of tests for each mutant")
    ask.add_argument("--out", type=Path, default=ROOT / "out/mutants")
    given = ask.parse_args()
    out = given.out.resolve()
    copy = out / "copy"
    make_copy(copy)
    os.chdir(copy)
    os.environ |= {"PYTHONPATH": str(copy), "NUMBA_DISABLE_JIT": "1", "OMP_NUM_THREADS": "1"}
    judges = Judges(out, survey(out))
    modules = [m for m in mutated_modules() if given.only in str(m)]
    kept = out / f"results_{given.seed}.jsonl"
    known = {r["key"]: r for r in map(json.loads, kept.read_text().splitlines())} \
        if kept.exists() else {}  # fmt: skip
    found = []
    for number, spec in enumerate(sample(modules, given.count, given.seed)):
        key = name_of(spec)
        result = known.get(key)
        if result is None or (given.again and result["outcome"] == "survived"):
            result = {"key": key, **judge(spec, judges, given.budget)}
            with open(kept, "a") as file:
                file.write(json.dumps(result) + "\n")
        found.append(result)
        print(f"{number + 1:4d} {result['outcome']:9s} {key}", flush=True)
    left = [r for r in found if r["outcome"] == "survived"]
    killed = len(found) - len(left)
    for result in left:
        print(f"\n{result['key']}  ({result['tests']} tests)\n{result['diff']}")
    score = 100.0 * killed / max(len(found), 1)
    print(f"\n{killed} of {len(found)} mutants noticed: {score:.1f} % (seed {given.seed})")


def make_copy(copy: Path) -> None:
    """A copy of what git knows, as it is now; files that are the same keep their dates."""
    words = ["git", "-C", str(ROOT), "ls-files", "-co", "--exclude-standard"]
    listed = subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
    for name in listed:
        source, target = ROOT / name, copy / name
        if not source.is_file():
            continue
        if not target.exists() or target.read_bytes() != source.read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)


def mutated_modules() -> list[Path]:
    """Relative paths."""
    package = Path("osc_contact")
    law = [p for p in sorted((package / "law").glob("*.py")) if p.name not in LEFT_OUT]
    return [*law, *(package / name for name in MODULES)]


def survey(out: Path) -> list[str]:
    """Run each judge once with coverage, unless neither it nor a module has changed since."""
    sources = b"".join(path.read_bytes() for path in mutated_modules())
    there = []
    for name in JUDGES:
        test = Path(f"tests/test_{name}.py")
        if not test.exists():
            continue
        stamp, seen = out / f"{name}.stamp", hashlib.sha1(sources + test.read_bytes()).hexdigest()
        there.append(name)
        if stamp.exists() and stamp.read_text() == seen:
            continue
        print(f"survey: {test}", flush=True)
        config = out / f"{name}.rc"
        files = "\n    ".join(map(str, mutated_modules()))
        config.write_text(
            f"[run]\nrelative_files = True\ndata_file = {out}/{name}.cov\ninclude =\n    {files}\n"
        )
        words = [
            *pytest(),
            f"--timeout={SLOW}",
            "--cov",
            f"--cov-config={config}",
            "--cov-context=test",
            "--cov-report=",
            f"--junitxml={out}/{name}.xml",
            str(test),
        ]
        subprocess.run(words, stdout=subprocess.DEVNULL, check=False)
        stamp.write_text(seen)
    return there


def pytest() -> list[str]:
    return [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:randomly"]


class Judges:
    """Which tests run which lines, and how long they take."""

    def __init__(self, out: Path, names: list[str]) -> None:
        self.seconds: dict[str, float] = {}
        self.by_line: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
        for name in names:
            for case in xml.parse(out / f"{name}.xml").iter("testcase"):
                if not list(case):  # passed
                    file = case.get("classname", "").replace(".", "/") + ".py"
                    self.seconds[f"{file}::{case.get('name')}"] = float(case.get("time", 0.0))
            data = CoverageData(str(out / f"{name}.cov"))
            data.read()
            for path in data.measured_files():
                for line, tests in data.contexts_by_lineno(path).items():
                    ran = {test.partition("|")[0] for test in tests} & self.seconds.keys()
                    self.by_line[path][line] |= ran

    def of(self, spec: MutationSpec, budget: float) -> list[str]:
        """The tests for a mutant, the shortest first."""
        path = str(spec.module_path)
        lines = self.by_line[path]
        source = spec.module_path.read_text().splitlines()
        first, last = spec.start_pos[0], spec.end_pos[0]
        tests = set().union(*(lines[i] for i in range(first, last + 1)))
        if not tests:  # runs when it is imported, or goes on in another line
            named = re.match(r"\s*(\w+)(:[^=]*)? = ", source[first - 1])
            tests = set(self._users(named[1])) if named and not named[0].startswith(" ") else set()
        if not tests:
            near = max((i for i in lines if i <= first and lines[i]), default=0)
            tests = lines[near] or set().union(*lines.values()) or set(self.seconds)
        chosen, spent = [], 0.0
        for test in sorted(tests, key=lambda t: self.seconds[t]):
            spent += self.seconds[test]
            if spent > budget and chosen:
                break
            chosen.append(test)
        return chosen

    def _users(self, name: str) -> Iterator[str]:
        word = re.compile(rf"\b{name}\b")
        for path, lines in self.by_line.items():
            for number, text in enumerate(Path(path).read_text().splitlines(), 1):
                if word.search(text):
                    yield from lines[number]


def sample(modules: list[Path], count: int, seed: int) -> list[MutationSpec]:
    """Places drawn at random, one mutant at each."""
    places: dict[tuple[str, tuple[int, int]], list[MutationSpec]] = defaultdict(list)
    for item in _all_work_items(modules, {}):
        (spec,) = item.mutations
        if OPERATORS.match(spec.operator_name):
            places[str(spec.module_path), spec.start_pos].append(spec)
    print(f"{sum(map(len, places.values()))} mutants at {len(places)} places", flush=True)
    rng = random.Random(seed)
    chosen = rng.sample(sorted(places), min(count, len(places)))
    return [rng.choice(places[place]) for place in chosen]


def name_of(spec: MutationSpec) -> str:
    """File, line and column, what is done there."""
    line, column = spec.start_pos
    return f"{spec.module_path}:{line}:{column} {spec.operator_name} {spec.occurrence}"


def judge(spec: MutationSpec, judges: Judges, budget: float) -> dict[str, object]:
    """Whether a test fails; what was changed."""
    tests = judges.of(spec, budget)
    command = " ".join([*pytest(), "-x", "--timeout=60", *(f"'{test}'" for test in tests)])
    result = mutate_and_test([spec], command, 3.0 * budget + 60.0)
    changed = [line for line in (result.diff or "").split("\n")
               if line[:1] in "+-" and line[:3] not in ("+++", "---")]  # fmt: skip
    outcome = "survived" if result.test_outcome == "survived" else "noticed"
    return {"outcome": outcome, "tests": len(tests), "diff": "\n".join(changed),
            "by": by(result.output or "")}  # fmt: skip


def by(output: str) -> str:
    """The test that failed."""
    found = re.findall(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    return found[0] if found else output[-200:]


if __name__ == "__main__":
    main()

"""Small faults put into the law, one at a time: how many of them do the tests notice?

    python tests/mutants.py [--count 300] [--seed 1] [--only TEXT] [--again] [--judges NAME ...]
                            [--compiled]

Works in a copy of the checkout, without compilation. First every judge (a test file that is fast
that way) is run once, with the lines that each of its tests runs. Then places are drawn at random,
a mutant at each; the tests that run its line judge it, the shortest first, until one fails or
those that take `--budget` seconds have passed. Mutants are cosmic-ray's; left out are those that
every run notices (operators that floats do not have) and none can (decorators, annotations).
Results are kept: the same command continues where it was, `--again` judges survivors once more. A
few `--judges` are a quick start; all of them judge what these leave with `--again`. `--compiled`
then judges the rest by whole test files with the law compiled, some of which are too slow without.
Times are the processor's, not the clock's: a busy machine changes no verdict.
"""

import argparse
import hashlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections import defaultdict
from difflib import unified_diff
from importlib import import_module
from pathlib import Path
from time import process_time

import pytest
from cosmic_ray.ast import ast_nodes, get_ast_from_path
from cosmic_ray.mutating import use_mutation
from cosmic_ray.plugins import get_operator, operator_names
from cosmic_ray.work_item import MutationSpec
from coverage import CoverageData

ROOT = Path(__file__).resolve().parent.parent
#: How the law is compiled is not the law: these lines do not run without compilation. Nor are the
#: sizes of records: larger ones are no fault, smaller ones end in an error.
LEFT_OUT = (
    "__init__.py",
    "c_object.py",
    "compiled.py",
    "ingredients.py",
    "jit.py",
    "layout_code.py",
    "library.py",
    "machine_code.py",
    "nested.py",
    "nested_tables.py",
    "nested_type.py",
    "numba_types.py",
    "platforms.py",
    "records.py",
    "store.py",
    "units.py",
)
MODULES = ("projections.py", "response.py", "control/monitor.py")
#: The tests of a part itself come first: of the modules named. `law_kkt` judges whole ticks after
#: them.
SENSORS = ("plausibility", "agreement", "sensors", "isolation", "wrist_readings")
JUDGES = {
    "law_parts": ("vectors", "algebra", "commands", "grasps", "contact", "columns", "normals"),
    "law_stages": (
        *("reading", "contact_friction", "operational", "command_filter", "allocation", "vectors"),
        *("tick", "limits", "saturation", "rows", "force_law"),
    ),
    "law_kkt": (),
    "law_watch": ("safety", *SENSORS),
    "ceilings": ("ceilings",),
    "hopping": ("hopping",),
    "levelling": ("levelling",),
    "witness": ("witness",),
    "joint_limits": ("allocation",),
    "contact_kinds": ("contact", "pair_geometry", "surfaces", "tangents"),
    "pairs": ("contact", "pair_geometry", "surfaces", "tangents"),
    "chain_state": ("arm_motion", "chain", "operational", "singular", "vectors", "grasps"),
    "grasps": ("grasps", "reading"),
    "projections": (),
    "spans": (),
    "outcome": ("monitor",),
    "law_limits": ("limits", "refinement", "saturation"),
    "law_phases": ("phases", "active_set"),
    "linkage": ("allocation", "bars"),
    "law_steps": ("commands",),
    "safety": ("safety",),
    "friction": ("contact_friction",),
    "reading": (),
    "moving_environment": ("response",),
    "singular": ("singular",),
    "tilted_faces": ("contact",),
    "controller": (),
    "operational_space": ("operational",),
    "joint_friction": ("joint_friction", "friction_estimate", "friction_slope"),
}
#: Further files, which judge the compiled law alone.
COMPILED = {
    "active_sets": ("active_set",),
    "phased_sets": (),
    "lying_sensors": (*SENSORS, "safety"),
    "stopped_arms": ("holding",),
    "effort_limits": ("saturation",),
    "soft_faces": ("commands",),
    "law": ("chain",),
    "fault_injection": ("safety",),
}
SLOW = 6  #: s; a test that takes longer without compilation is no judge
CHECK = 2.0  #: s of tests that have to pass without any mutant, three times
SECONDS = "MUTANTS_SECONDS"  #: the file for the times of a survey
_passed = {}  #: seconds of each test
OPERATORS = re.compile(
    r"""core/(ReplaceBinaryOperator_(Add_Sub|Add_Mul|Sub_Add|Mul_Div|Mul_Add|Div_Mul|Pow_Mul
        |Mod_FloorDiv|FloorDiv_Mul)|ReplaceComparisonOperator_(?!Is)\w+(?<!Is)(?<!IsNot)
        |ReplaceUnaryOperator_(USub_UAdd|Delete_Not)|AddNot|ReplaceTrueWithFalse
        |ReplaceFalseWithTrue|ReplaceAndWithOr|ReplaceOrWithAnd|ReplaceBreakWithContinue
        |ReplaceContinueWithBreak|NumberReplacer|ZeroIterationForLoop)$""",
    re.VERBOSE,
)


def main():
    """Draw, judge, count."""
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--count", type=int, default=300, help="mutants")
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--only", default="", help="modules whose path holds this text")
    ask.add_argument("--again", action="store_true", help="judge survivors once more")
    ask.add_argument("--compiled", action="store_true", help="judge survivors by compiled tests")
    ask.add_argument("--budget", type=float, default=40.0, help="s of tests for each mutant")
    ask.add_argument("--judges", nargs="+", choices=JUDGES, default=[*JUDGES], metavar="NAME")
    ask.add_argument("--out", type=Path, default=ROOT / "out/mutants")
    given = ask.parse_args()
    out = given.out.resolve()
    copy = out / "copy"
    make_copy(copy)
    os.chdir(copy)
    os.environ |= {"PYTHONPATH": str(copy), "NUMBA_DISABLE_JIT": "1", "OMP_NUM_THREADS": "1"}
    survey(out, given.judges)
    judges = Judges(out, given.judges)
    modules = [m for m in mutated_modules() if given.only in str(m)]
    kept = out / f"results_{given.seed}.jsonl"
    kept.touch()
    known = {r["key"]: r for r in map(json.loads, kept.read_text().splitlines())}
    import_others()
    sys.path[:0] = [str(copy), str(copy / "tests")]
    found = []
    drawn = sample(modules, given.count, given.seed)
    for spec in drawn[:3]:
        if not run_forked(judges.of(spec, CHECK), 600):
            sys.exit(f"the tests of {name_of(spec)} fail without any mutant")
    if given.compiled and not run_compiled(out / "cache"):
        sys.exit("tests of the compiled law fail without any mutant")
    for number, spec in enumerate(drawn):
        key = name_of(spec)
        result = known.get(key)
        if result is None or (given.again and result["outcome"] == "survived"):
            result = {"key": key, **judge(spec, judges, given.budget)}
            note(kept, result)
        if given.compiled and result["outcome"] == "survived" and "files" not in result:
            result |= judge_compiled(spec, out / "cache")
            note(kept, result)
        found.append(result)
        print(f"{number + 1:4d} {result['outcome']:9s} {key}", flush=True)
    left = [r for r in found if r["outcome"] == "survived"]
    killed = len(found) - len(left)
    for result in left:
        print(f"\n{result['key']}  ({result['tests']} tests)\n{result['diff']}")
    score = 100.0 * killed / max(len(found), 1)
    print(f"\n{killed} of {len(found)} mutants noticed: {score:.1f} % (seed {given.seed})")


def note(kept, result):
    """Append a result to the file of results; later ones of a mutant replace earlier ones."""
    with open(kept, "a") as file:
        file.write(json.dumps(result) + "\n")


def make_copy(copy):
    """A copy of the files of git, as they are now; files that are the same keep their dates."""
    words = ["git", "-C", str(ROOT), "ls-files", "-co", "--exclude-standard"]
    listed = subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
    for name in listed:
        source = ROOT / name
        target = copy / name
        if not source.is_file():
            continue
        if not target.exists() or target.read_bytes() != source.read_bytes():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(source, target)


def mutated_modules():
    """Relative paths."""
    package = Path("osc_contact")
    law = [p for p in sorted((package / "law").glob("*.py")) if p.name not in LEFT_OUT]
    return [*law, *(package / name for name in MODULES)]


def survey(out, names):
    """Run each judge once with coverage, unless neither it nor a module has changed since."""
    sources = b"".join(path.read_bytes() for path in mutated_modules())
    for name in names:
        test = Path(f"tests/test_{name}.py")
        stamp = out / f"{name}.stamp"
        seen = hashlib.sha1(sources + test.read_bytes()).hexdigest()
        if stamp.exists() and stamp.read_text() == seen:
            continue
        print(f"survey: {test}", flush=True)
        config = out / f"{name}.rc"
        files = "\n    ".join(map(str, mutated_modules()))
        config.write_text(
            f"[run]\nrelative_files = True\ndata_file = {out}/{name}.cov\ninclude =\n    {files}\n"
        )
        words = [
            *(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "mutants"),
            "--tb=no",
            "--cov",
            f"--cov-config={config}",
            "--cov-context=test",
            "--cov-report=",
            str(test),
        ]
        where = {"PYTHONPATH": f"{Path.cwd()}:{Path.cwd()}/tests", SECONDS: f"{out}/{name}.json"}
        ended = subprocess.run(words, stdout=subprocess.DEVNULL, env={**os.environ, **where})
        if ended.returncode not in (0, 1):  # some pass; others are too slow
            sys.exit(f"the survey of {test} ended with {ended.returncode}")
        stamp.write_text(seen)


class TooSlow(BaseException):
    """A test that is no judge; not an error that a run may handle."""


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    """In a survey: give up what is slow, note how long the others take."""

    def give_up(_, frame):
        if "/coverage/" in frame.f_code.co_filename:  # its lock would never be released
            signal.setitimer(signal.ITIMER_PROF, 1e-3)
        else:
            raise TooSlow(f"no judge: longer than {SLOW} s")

    signal.signal(signal.SIGPROF, give_up)
    signal.setitimer(signal.ITIMER_PROF, SLOW)
    begin = process_time()
    try:
        yield
        _passed[item.nodeid] = process_time() - begin
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def pytest_sessionfinish():
    """Hand over the times of a survey."""
    Path(os.environ[SECONDS]).write_text(json.dumps(_passed))


class Judges:
    """Tests by the lines that they run, and their durations."""

    def __init__(self, out, names):
        self.seconds = {}
        self.by_line = defaultdict(lambda: defaultdict(set))  # tests by path and line
        for name in names:
            self.seconds |= json.loads((out / f"{name}.json").read_text())
            data = CoverageData(str(out / f"{name}.cov"))
            data.read()
            for path in data.measured_files():
                for line, tests in data.contexts_by_lineno(path).items():
                    ran = {test.partition("|")[0] for test in tests} & self.seconds.keys()
                    self.by_line[path][line] |= ran

    def of(self, spec, budget):
        """The tests for a mutant, the shortest first."""
        lines = self.by_line[str(spec.module_path)]
        source = spec.module_path.read_text().splitlines()
        first = spec.start_pos[0]
        last = spec.end_pos[0]
        named = re.match(r"(\w+)(:[^=]*)? = ", source[first - 1])
        if named:  # a constant: runs when it is imported, by whatever test imports it first
            tests = set(self._users(named[1]))
        else:
            tests = set().union(*(lines[i] for i in range(first, last + 1)))
        if not tests:  # continues in another line
            near = max((i for i in lines if i <= first and lines[i]), default=0)
            tests = lines[near] or set().union(*lines.values()) or set(self.seconds)
        chosen = []
        spent = 0.0
        own = [f"test_{judge}.py" for judge, of in JUDGES.items() if spec.module_path.stem in of]
        for test in sorted(tests, key=lambda t: (not any(o in t for o in own), self.seconds[t])):
            spent += self.seconds[test]
            if spent > budget and chosen:
                break
            chosen.append(test)
        return chosen

    def _users(self, name):
        word = re.compile(rf"\b{name}\b")
        for path, lines in self.by_line.items():
            for number, text in enumerate(Path(path).read_text().splitlines(), 1):
                if word.search(text):
                    yield from lines[number]


def sample(modules, count, seed):
    """Places drawn at random, one mutant at each."""
    places = defaultdict(list)  # mutants by path and position
    operators = {name: get_operator(name)() for name in operator_names() if OPERATORS.match(name)}
    for module in modules:
        nodes = list(ast_nodes(get_ast_from_path(module)))
        for name, operator in operators.items():
            spots = [spot for node in nodes for spot in operator.mutation_positions(node)]
            for occurrence, (start, end) in enumerate(spots):
                spec = MutationSpec(module, name, occurrence, start, end)
                places[str(module), start].append(spec)
    print(f"{sum(map(len, places.values()))} mutants at {len(places)} places", flush=True)
    rng = random.Random(seed)
    chosen = rng.sample(sorted(places), min(count, len(places)))
    return [rng.choice(places[place]) for place in chosen]


def name_of(spec):
    """File, line and column, what is done there."""
    line, column = spec.start_pos
    return f"{spec.module_path}:{line}:{column} {spec.operator_name} {spec.occurrence}"


def judge(spec, judges, budget):
    """Whether a test fails; what was changed."""
    tests = judges.of(spec, budget)
    operator = get_operator(spec.operator_name)()
    with use_mutation(spec.module_path, operator, spec.occurrence) as (before, after):
        passed = run_forked(tests, round(3.0 * budget + 60.0))
    lines = unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    diff = "\n".join([*lines][3:])
    return {"outcome": "survived" if passed else "noticed", "tests": len(tests), "diff": diff}


def judge_compiled(spec, cache):
    """Whether a test of a whole file fails with the mutant compiled; the number of files.

    A crash is noticed, too, and what does not compile.
    """
    operator = get_operator(spec.operator_name)()
    with use_mutation(spec.module_path, operator, spec.occurrence) as (_, after):
        # numba knows no type of an empty list
        spec.module_path.write_text(after.replace(" in []:", " in range(0):"))
        passed = run_compiled(cache, spec.module_path.stem)
    return {"outcome": "survived" if passed else "noticed", "files": len(JUDGES) + len(COMPILED)}


def run_compiled(cache, stem=""):
    """Whether all judges pass with the law compiled, those of the module `stem` first."""
    cache.mkdir(0o700, exist_ok=True)
    modules = JUDGES | COMPILED
    names = sorted(modules, key=lambda name: stem not in modules[name])
    files = [f"tests/test_{name}.py" for name in names]
    words = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", "not slow"]
    where = {**os.environ, "OSC_CONTACT_LAW": "quick", "OSC_CONTACT_CACHE": str(cache)}
    del where["NUMBA_DISABLE_JIT"]
    code = subprocess.run([*words, *files], stdout=subprocess.DEVNULL, env=where).returncode
    if code > 2:
        sys.exit(f"pytest ended with {code}: {files[:3]} …")
    return code == 0


def run_forked(tests, seconds):
    """Whether all tests pass, in a child that need not import what is not ours."""
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        os._exit(pytest.main(["-q", "-x", "-p", "no:cacheprovider", *tests]))
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status not in (0, 1, 2, 4, -signal.SIGXCPU, -signal.SIGKILL, -signal.SIGSEGV):
        sys.exit(f"pytest ended with {status}: {tests[:3]} …")
    return status == 0


def import_others():
    """Everything that is not ours, once for all children."""
    sys.dont_write_bytecode = True
    for name in (
        "coal",
        "daqp",
        "mcap",
        "numba",
        "numba.extending",
        "pinocchio",
        "pydantic",
        "pytest",
        "rich.console",
        "typer.testing",
        "yaml",
        "yourdfpy",
    ):
        import_module(name)


if __name__ == "__main__":
    main()

"""Benchmark of the time to compile the law: whole, on one core, after an edit of one function."""

import ast
import os
import random
import resource
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import osc_contact
from benchmarks.measuring import Rows
from osc_contact.errors import OscContactError

#: Makes the library where there is none, and calls it once.
FIRST_TICK = """
from benchmarks.tick import CASES
case = CASES["two_contact_rod"]()
case.controller().tick(*case.given)
"""
COMPILE = ("-m", "osc_contact.law.c_object")
LAWS = {"": "", "quick": ", quick"}  #: values of OSC_CONTACT_LAW, and what they add to a row's name
PARTS = {"inner", "leaf"}  #: decorators of the functions that are translated by themselves


class NotCompiledError(OscContactError):
    """A process that compiles the law failed."""


def measure(count: int) -> dict[str, Rows]:
    """{"compilation": rows}: seconds on the clock and of the processor.

    The law is compiled in a copy of the package: with an empty cache, likewise on a single core,
    and after each of some edits until the end of the first tick, in the usual way and with
    OSC_CONTACT_LAW=quick. An edit multiplies a product of a function by 1.5; functions are drawn at
    random by a fixed seed.

    Args:
        count: edits, each of another function.

    Raises:
        OscContactError: the law was not compiled.
    """
    rows = []
    times: dict[str, Rows] = {law: [] for law in LAWS}
    with TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        for package in ("osc_contact", "benchmarks", "paper", "urdf"):
            source = Path(osc_contact.__file__).parents[1] / package
            shutil.copytree(source, copy / package)
        rows.append({"what": "whole", **timed_python(COMPILE, copy, f"{folder}/whole")})
        one_core = {min(os.sched_getaffinity(0))}
        rows.append(
            {"what": "on one core", **timed_python(COMPILE, copy, f"{folder}/one", one_core)}
        )
        tick = ("-c", FIRST_TICK)
        for law in LAWS:
            shutil.copytree(f"{folder}/whole", f"{folder}/whole-{law}")
            timed_python(tick, copy, f"{folder}/whole-{law}", law=law)
        for file, name, edited in edits(copy / "osc_contact/law"):
            if len(times[""]) == count:
                break
            usual = file.read_text()
            file.write_text(edited)
            with suppress(NotCompiledError):  # products of whole numbers have to stay whole
                for law in LAWS:  # each with a cache of its own
                    seconds = timed_python(tick, copy, f"{folder}/whole-{law}", law=law)
                    times[law].append({"what": f"edit of {name}{LAWS[law]}", **seconds})
            file.write_text(usual)
    for law, found in times.items():
        found.sort(key=lambda row: float(row["clock (s)"]))
        middle = {**found[len(found) // 2], "what": f"median of {len(found)} edits{LAWS[law]}"}
        rows += [middle, *found]
    return {"compilation": rows}


def timed_python(
    words: tuple[str, ...],
    copy: Path,
    cache: str,
    cores: set[int] | None = None,
    law: str = "",
) -> dict[str, float]:
    """Seconds that Python takes in a copy of the package, with all processes that it starts.

    Args:
        words: after the interpreter.
        copy: folder of the package.
        cache: folder of what is kept.
        cores: number of cores that it may use; None: all.
        law: value of OSC_CONTACT_LAW.

    Raises:
        NotCompiledError: it failed.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began = perf_counter()
    done = subprocess.run(
        [sys.executable, *words],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy), "OSC_CONTACT_CACHE": cache}
        | {"OSC_CONTACT_LAW": law, "PYTHONDONTWRITEBYTECODE": ""},
        preexec_fn=lambda: os.sched_setaffinity(0, cores or os.sched_getaffinity(0)),
        capture_output=True,
        text=True,
    )
    clock = perf_counter() - began
    if done.returncode != 0:
        raise NotCompiledError(f"the law was not compiled: {done.stderr[-1000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"clock (s)": clock, "processor (s)": processor}


def edits(law: Path) -> list[tuple[Path, str, str]]:
    """Functions with a product, in random order: a file, the function, and the file edited.

    Args:
        law: folder of the sources.
    """
    found = []
    for path in sorted(law.glob("*.py")):
        source = path.read_text()
        for function in ast.walk(ast.parse(source)):
            if not isinstance(function, ast.FunctionDef):
                continue
            if not any(isinstance(x, ast.Name) and x.id in PARTS for x in function.decorator_list):
                continue
            for one in ast.walk(function):
                if not (isinstance(one, ast.BinOp) and isinstance(one.op, ast.Mult)):
                    continue
                text = ast.get_source_segment(source, one) or ""
                if source.count(text) == 1:
                    found.append((path, function.name, source.replace(text, f"(1.5 * ({text}))")))
                    break
    random.Random(1).shuffle(found)
    return found

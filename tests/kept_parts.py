"""Test that an edited law is compiled from stored parts to the same object file as without them.

    python tests/kept_parts.py [--count 20] [--seed 1] [--entries osc_law_rows ...]

It works in a copy of the package. Functions are drawn at random; in each a number or a comparison
is changed, and the object file of the entries is compiled twice: with the parts that were stored
before the edit, and with an empty store. Both have to be equal to the byte, and different from the
file before the edit.
"""

import argparse
import ast
import json
import random
import shutil
import sys
import tempfile
from pathlib import Path

from processes import python

import osc_contact

#: Program that compiles the object file of some entries, and prints its hash, the names of its
#: units, and the number of parts that were not in the store.
PROGRAM = """
import json, sys
from hashlib import sha256
from osc_contact.law import c_object, jit, machine_code, platforms
kept = []
jit.UNITS.watchers[:] = [lambda share, found: kept.append(found)]
entries = {entry.__name__: entry for entry in c_object.ENTRIES}
roots = {name: c_object._translated(entries[name]) for name in sys.argv[1:] or entries}
made = machine_code.emit(roots, platforms.target_of())
units = [unit.name for unit in jit.UNITS.all_units() if unit.known]
print(json.dumps([sha256(made).hexdigest(), units, kept.count(False)]))
"""
TIMEOUT = 3000  #: time limit (s); compiling all entries takes a minute of an idle core
#: Comparison that replaces each comparison.
OTHERS = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq}


def made(copy, store, entries):
    """Compile in a copy of the package; return hash, units and number of parts not in the store.

    Args:
        copy: folder of the copy.
        store: folder of the store.
        entries: names of entries; none: all.
    """
    environment = {"OSC_CONTACT_CACHE": store, "OSC_CONTACT_LAW": "compile"}
    environment["NUMBA_DISABLE_JIT"] = "0"
    done = python("-c", PROGRAM, *entries, cwd=copy, timeout=TIMEOUT, **environment)
    return json.loads(done.stdout)


def edit(source, name, rng):
    """Change a random number or comparison of a function; return the module's source.

    Args:
        source: source of the module.
        name: name of the function.
        rng: random numbers.

    Returns:
        The changed source; None if the function has neither numbers nor comparisons.
    """
    tree = ast.parse(source)
    [function] = [
        one for one in ast.walk(tree) if isinstance(one, ast.FunctionDef) and one.name == name
    ]
    places = []
    for one in ast.walk(function):
        if isinstance(one, ast.Constant) and isinstance(one.value, float):
            places.append(one)
        if isinstance(one, ast.Compare) and type(one.ops[0]) in OTHERS:
            places.append(one)
    if not places:
        return None
    place = rng.choice(places)
    if isinstance(place, ast.Compare):
        place.ops[0] = OTHERS[type(place.ops[0])]()
    else:
        place.value = 1.25 * place.value + 0.125
    return ast.unparse(tree)


def compare(count, seed, entries=()):
    """Edit functions and compare the object files; yield a line of text for each function.

    Args:
        count: number of edits.
        seed: seed of the random numbers.
        entries: names; none: all.

    Raises:
        AssertionError: object files differ, or too few functions can be edited.
    """
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy"
        shutil.copytree(Path(osc_contact.__file__).parent, copy / "osc_contact")
        kept = f"{folder}/kept"
        before, units, _ = made(copy, kept, entries)
        rng.shuffle(units)
        done = 0
        for unit in units:
            module, _, name = unit.rpartition(".")
            path = copy / "osc_contact/law" / f"{module}.py"
            source = path.read_text()
            changed = edit(source, name, rng)
            if changed is None:
                continue
            path.write_text(changed)
            now, _, new = made(copy, kept, entries)
            anew, _, all_parts = made(copy, f"{folder}/empty-{done}", entries)
            path.write_text(source)
            yield f"{unit}: {new} of {all_parts} parts new, objects {now[:8]} and {anew[:8]}"
            assert now == anew and now != before and new < all_parts, unit
            done += 1
            if done == count:
                return
    raise AssertionError(f"only {done} functions could be edited")


if __name__ == "__main__":
    ask = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    ask.add_argument("--count", type=int, default=20, help="edits")
    ask.add_argument("--seed", type=int, default=1)
    ask.add_argument("--entries", nargs="*", default=[], help="of law.c_object; default: all")
    given = ask.parse_args()
    for line in compare(given.count, given.seed, given.entries):
        print(line, flush=True)
    sys.exit()

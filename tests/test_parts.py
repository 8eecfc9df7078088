"""Parts of the law are kept: under keys that see every edit, in a store that notices damage."""

import ast
import json
import os
import random
import shutil
import threading
from collections import defaultdict
from pathlib import Path

from kept_parts import compare, made
from processes import python
from pytest import mark, raises
from samples import ROOT, module_fixture, names_in, parametrize

from osc_contact import law
from osc_contact.law.ingredients import digest, ingredients
from osc_contact.law.store import Store

LAW = Path(law.__file__).parent

# --- Keys -----------------------------------------------------------------------------------------

#: Every value that parts read is edited in turn; every function is edited in turn. A line for each:
#: what was edited, then the parts whose keys changed.
EDITS = '''
import ast, inspect, json, sys, textwrap
import numpy as np
from osc_contact.law import c_object, jit
from osc_contact.law.ingredients import digest
from osc_contact.law.nested import Nested

units = {unit.name: unit for unit in jit.UNITS.all_units()}
modules = {name.rpartition(".")[2]: module for name, module in sys.modules.items()
           if name.startswith("osc_contact.law.")}

def digests():
    return {name: digest(unit.py_func) for name, unit in units.items()}

before = digests()

def changed():
    now = digests()
    return sorted(name for name in units if now[name] != before[name])

def edited(value):
    """Another value of the same type; None: it is edited in another way."""
    if isinstance(value, bool | int):
        return type(value)(not value) if isinstance(value, bool) else value + 1
    if isinstance(value, float):
        return -value if value != 0.0 and value == value else 0.5
    if isinstance(value, tuple):
        return (*value, 1.0)
    return None

def with_statement(function):
    """The code of a function with one more statement."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    definition = tree.body[0]
    definition.decorator_list = []
    definition.body.append(ast.parse("edited = 1.0").body[0])
    definition.body.insert(-1, ast.parse("edited = 2.0").body[0])
    space = {}
    exec(compile(ast.fix_missing_locations(tree), "edited", "exec"), function.__globals__, space)
    return space[function.__name__].__code__

def with_another_field(kind):
    """A record with one more number in its head."""
    head = [(name, kind.dtype[name]) for name in kind.dtype.names if name != "layout"]
    tables = {name: (dtype, *sizes) for name, (dtype, sizes) in kind.tables.items()}
    return Nested(np.dtype([*head, ("edited", float)], align=True), **tables)

#: Functions that find a record in bytes, with the record.
records = {id(kind.at): kind for module in modules.values() for kind in vars(module).values()
           if isinstance(kind, Nested)}
found = {}
for home, module in modules.items():
    for name, value in list(vars(module).items()):
        function = getattr(value, "py_func", None)
        if function is not None and function.__module__ == module.__name__:
            usual = function.__code__
            function.__code__ = with_statement(function)
            found[f"{home}.{function.__name__}"] = changed()
            function.__code__ = usual
        elif id(value) in records:
            vars(module)[name] = with_another_field(records[id(value)]).at
            found[f"{home}.{name}"] = changed()
            vars(module)[name] = value
        elif edited(value) is not None:
            vars(module)[name] = edited(value)
            found[f"{home}.{name}"] = changed()
            vars(module)[name] = value
assert digests() == before
print(json.dumps(found))
'''


class Sources:
    """The law's sources as a graph of names.

    Attributes:
        functions: definitions by module and name.
        units: those that are translated by themselves.
    """

    def __init__(self):
        self.functions = {}
        self._imported = {}
        for path in sorted(LAW.glob("*.py")):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.FunctionDef):
                    self.functions[path.stem, node.name] = node
                if isinstance(node, ast.ImportFrom):
                    self._note_import(path.stem, node)
        self.units = {key for key, node in self.functions.items() if PARTS & marks_of(node)}
        self._readers = (defaultdict(set), defaultdict(set))  # of a binding, of a definition
        for function in self.functions:
            for read in self._reads(function):
                for readers, place in zip(self._readers, read, strict=True):
                    readers[place].add(function)

    def _note_import(self, module, node):
        package, _, home = (node.module or "").rpartition(".")
        for alias in node.names:
            if package == "osc_contact.law":
                self._imported[module, alias.asname or alias.name] = (home, alias.name)
            if (package, home) == ("osc_contact", "law"):
                self._imported[module, alias.asname or alias.name] = (alias.name, None)

    def _reads(self, function):
        """Values that a function reads: module and name of binding and definition."""
        module, _ = function
        for name, member in names_in_body(self.functions[function]):
            home, original = self._imported.get((module, name), (module, name))
            if original is None:
                yield ((home, member), (home, member))
            else:
                yield ((module, name), (home, original))

    def concerned(self, edited):
        """Units that are to be translated again after an edit of a name.

        Args:
            edited: module and name of a binding, or of a function that is defined there.
        """
        found = set()
        left = [edited]
        seen = set()
        while left:
            one = left.pop()
            if one in seen:
                continue
            seen.add(one)
            if one in self.units:
                found.add(one)  # who calls it reads its name only
            else:
                left += self._readers[one in self.functions][one]
        return found


#: Decorators of functions that are translated by themselves.
PARTS = {"inner", "leaf", "entry"}


def marks_of(node):
    return {one.id for one in node.decorator_list if isinstance(one, ast.Name)}


def names_in_body(node):
    """Global names that the body of a function reads, each with a member of it that is read."""
    body = [one for statement in node.body for one in ast.walk(statement)]
    names = [one for one in body if isinstance(one, ast.Name)]
    own = {one.arg for one in node.args.args}
    own |= {one.id for one in names if isinstance(one.ctx, ast.Store)}
    members = [(one, None) for one in names]
    members += [(one.value, one.attr) for one in body if isinstance(one, ast.Attribute)]
    for name, member in members:
        if isinstance(name, ast.Name) and name.id not in own:
            yield (name.id, member)


@module_fixture
def edits(tmp_path_factory):
    """Units whose keys each edit changed."""
    environment = {"NUMBA_DISABLE_JIT": "0", "OSC_CONTACT_LAW": "compile"}
    folder = str(tmp_path_factory.mktemp("cache"))
    done = python("-c", EDITS, OSC_CONTACT_CACHE=folder, **environment)
    return json.loads(done.stdout)


def test_an_edit_changes_the_keys_of_the_parts_that_it_concerns_and_of_no_others(edits):
    """Compared with a graph of names that is made from the sources."""
    sources = Sources()
    entries = {"c_object"}  # wraps the entries that other modules define
    for edit, changed in edits.items():
        name = tuple(edit.rsplit(".", 1))
        found = {tuple(one.rsplit(".", 1)) for one in changed}
        found = {one for one in found if one[0] not in entries}
        expected = {one for one in sources.concerned(name) if one[0] not in entries}
        assert found == expected, edit
    assert sum(map(bool, edits.values())) > 500


#: For every table of every record that parts take, whether the key of a part changes with it.
TABLES = """
import json
import numpy as np
from osc_contact.law import c_object, jit, nested_type, records
from osc_contact.law.nested import Nested

def record_of(kind, tables):
    head = [(name, kind.dtype[name]) for name in kind.dtype.names if name != "layout"]
    nested_type._records.clear()
    Nested(np.dtype(head, align=True), **tables)
    [record] = nested_type._records.values()
    return record

unit = next(iter(jit.UNITS.all_units()))
found = {}
for name, kind in vars(records).items():
    if not isinstance(kind, Nested):
        continue
    tables = {table: (dtype, *sizes) for table, (dtype, sizes) in kind.tables.items()}
    usual = unit.key((record_of(kind, tables),))
    found[name] = [unit.key((record_of(kind, tables),)) == usual]
    for table, (dtype, *sizes) in tables.items():
        fields = [(field, dtype[field]) for field in dtype.names or ()] or [("number", dtype)]
        edited = np.dtype([*fields, ("edited", float)], align=True)
        key = unit.key((record_of(kind, {**tables, table: (edited, *sizes)}),))
        found[name].append(key != usual)
print(json.dumps(found))
"""


def test_the_keys_see_every_table_of_a_record_that_a_part_takes():
    """Also of a part that calls none and returns no record, so that nothing else in it shows them.

    One of these was kept with rows of 584 bytes where they had 600: old code ran.
    """
    done = python("-c", TABLES, NUMBA_DISABLE_JIT="0", OSC_CONTACT_LAW="compile")
    found = json.loads(done.stdout)
    assert {"MODEL", "MEMORY", "WORK"} <= {*found} and all(map(all, found.values())), found
    assert sum(map(len, found.values())) > 20


def test_the_keys_see_no_comment_and_no_docstring():
    sources = {
        "usual": 'def f(x):\n    """A."""\n    return LEAST * x\n',
        "commented": 'def f(x):\n    """B, at length."""\n\n    # slowly\n    return LEAST * x\n',
        "other": 'def f(x):\n    """A."""\n    return LEAST + x\n',
    }
    keys = {}
    for name, source in sources.items():
        space = {"LEAST": 2.0}
        exec(source, space)
        keys[name] = digest(space["f"])
    assert keys["usual"] == keys["commented"] != keys["other"]


def test_a_value_whose_content_cannot_be_seen_is_refused():
    """Or an edit of it would go unnoticed."""
    space = {"TABLE": {"a": 1.0}}
    exec("def f(x):\n    return TABLE[x]", space)
    with raises(TypeError, match="f reads TABLE: a dict, whose content"):
        ingredients(space["f"])


# --- Objects --------------------------------------------------------------------------------------

SMALL = ["osc_law_prepare", "osc_law_settle"]


def test_an_edited_law_of_kept_parts_is_the_law_that_is_made_without_them():
    """Two functions, drawn anew each time; `tests/kept_parts.py` draws more, of all entries."""
    assert len(list(compare(2, random.randrange(1 << 30), SMALL))) == 2


@mark.slow
def test_the_whole_law_of_kept_parts_is_the_law_that_is_made_without_them():
    assert len(list(compare(2, random.randrange(1 << 30)))) == 2


@module_fixture
def kept(tmp_path_factory):
    """A store with the parts of the small entries; what `kept_parts.made` returned for them."""
    folder = tmp_path_factory.mktemp("kept")
    return (folder, made(ROOT, folder, SMALL))


def copied(folder, target):
    """A copy of a store; the parts in it, without the object."""
    shutil.copytree(folder, target)
    parts = sorted((target / "parts").iterdir())
    for path in parts:
        if path.name.startswith("object-"):
            path.unlink()
    return [path for path in parts if path.exists()]


def test_parts_that_hand_on_a_record_of_another_layout_are_made_anew(kept, tmp_path):
    """The key of an entry holds its arguments, bytes: what it makes of them is another record."""
    copy = tmp_path / "copy"
    shutil.copytree(LAW.parent, copy / "osc_contact")
    limits = copy / "osc_contact" / "law" / "limits.py"
    source = limits.read_text()
    assert source.count("    lost_squeeze=") == 1
    limits.write_text(source.replace("    lost_squeeze=", '    edited="s",\n    lost_squeeze='))
    shutil.copytree(kept[0], tmp_path / "store")
    found, _, new = made(copy, tmp_path / "store", SMALL)
    assert new and found == made(copy, tmp_path / "empty", SMALL)[0] != kept[1][0]


DAMAGE = {
    "half": lambda content: content[: len(content) // 2],
    "empty": lambda content: b"",
    "flipped": lambda content: content[:-1] + bytes([content[-1] ^ 1]),
    "another": lambda content: b"0" * len(content),
}


@parametrize("kind", DAMAGE)
def test_damaged_parts_are_made_anew(kind, kept, tmp_path):
    folder, (before, _, parts) = kept
    found = copied(folder, tmp_path / "store")
    assert len(found) == parts
    for path in found[::3]:
        path.write_bytes(DAMAGE[kind](path.read_bytes()))
    assert made(ROOT, tmp_path / "store", SMALL)[::2] == [before, len(found[::3])]
    assert made(ROOT, tmp_path / "store", SMALL)[::2] == [before, 0]


def test_two_processes_that_translate_at_once_make_the_same(kept, tmp_path):
    """Neither waits for the other. The object's key holds the code of all parts."""
    found = []
    work = [
        threading.Thread(target=lambda: found.append(made(ROOT, tmp_path, SMALL))) for _ in range(2)
    ]
    for one in work:
        one.start()
    for one in work:
        one.join()
    folder, (before, *_) = kept
    assert [one[0] for one in found] == [before, before]
    assert names_in(tmp_path / "parts") == names_in(folder / "parts")


def test_a_platform_that_is_not_listed_is_refused_before_anything_is_translated(tmp_path):
    words = ["-m", "osc_contact.law.c_object", "sparc64-linux-gnu", tmp_path / "law.o"]
    environment = {"OSC_CONTACT_LAW": "compile", "NUMBA_DISABLE_JIT": "0"}
    done = python(*words, code=1, OSC_CONTACT_CACHE=str(tmp_path / "cache"), **environment)
    assert "its first word is 'sparc64', and known are AMD64, aarch64" in done.stderr
    assert not list(tmp_path.iterdir())


# --- The store ------------------------------------------------------------------------------------


def test_what_is_kept_is_found_under_its_key_only(tmp_path):
    store = Store(tmp_path / "store")
    assert store.find("a") is None
    store.keep("a", b"content")
    assert store.find("a") == b"content" and store.find("b") is None
    shutil.copy(store.folder / "a", store.folder / "b")
    assert store.find("b") is None  # the content of another key


def test_what_was_not_used_for_long_is_removed(tmp_path):
    store = Store(tmp_path / "store")
    for key in "abc":
        store.keep(key, key.encode())
    for age, key in enumerate("cba"):
        os.utime(store.folder / key, (age, age))
    assert store.find("c") == b"c"  # used just now
    store.remove_old(2)
    assert names_in(store.folder) == {"a", "c"}


@parametrize("open_to_others", ["store", "."])
def test_nothing_is_taken_from_a_folder_that_others_may_write_to(open_to_others, tmp_path):
    """Parts become programs that run."""
    store = Store(tmp_path / "store")
    store.keep("a", b"content")
    (tmp_path / open_to_others).chmod(0o777)
    assert store.find("a") is None
    store.keep("b", b"content")
    (tmp_path / open_to_others).chmod(0o700)
    assert store.find("a") == b"content" and store.find("b") is None


def test_a_folder_that_cannot_be_written_to_keeps_nothing(tmp_path):
    (tmp_path / "file").write_text("")
    store = Store(tmp_path / "file")
    store.keep("a", b"content")
    store.remove_old(0)
    assert store.find("a") is None

"""The law as WebAssembly: replayed in Node.js, refused where it would be wrong without an error."""

import json
import shutil
from pathlib import Path

from processes import completed, python
from pytest import mark
from rigs import rig_of
from samples import made_once, module_fixture, parametrize

import osc_contact
from osc_contact.control.web_assembly import MODULE, law_wasm
from osc_contact.control.without_python import write_sources
from osc_contact.lab.runs.tape import build
from osc_contact.law import library
from osc_contact.law.jit import HAS_LIBRARY

pytestmark = mark.skipif(not HAS_LIBRARY, reason="no library of the law is used here")
WRAPPER = Path(osc_contact.__file__).parent / "control" / "web_files" / "controller.mjs"
REPLAY = Path(__file__).with_name("replay_in_node.mjs")
LARGEST = (
    1e-7  #: N m, of differences of torques; the same operations, other libraries of sin and atan2
)
#: plain, redundant, two Pandas, bars, motor limits, bodies that move, phases, tare and sensors
TASKS = (
    "two_contact_rod",
    "panda_edge",
    "dual_panda_rod",
    "three_arm_plate",
    "limited_rod",
    "moving_face",
    "approach_and_slide",
)


def node(*words):
    """Output of Node.js, which `make browser` installs."""
    assert shutil.which("node"), "there is no Node.js here: make browser, or apt-get install nodejs"
    return completed("node", *words).stdout


@module_fixture
def module(tmp_path_factory):
    """law.wasm, made once for all workers."""
    made = made_once(
        tmp_path_factory, "wasm", lambda folder: (folder / MODULE).write_bytes(law_wasm())
    )
    return made / MODULE


def test_recorded_ticks_are_those_of_the_compiled_law(module, tmp_path):
    for name in TASKS:
        build(rig_of(name), tmp_path / name, ticks=1000)
    replayed = json.loads(node(REPLAY, module, WRAPPER, *(tmp_path / name for name in TASKS)))
    for name, one in zip(TASKS, replayed, strict=True):
        assert (one["ticks"], one["otherStatuses"]) == (1000, 0), name
        assert one["worst"] <= LARGEST < one["largest"], name
        assert ("1" in one["statuses"]) == (name == "limited_rod"), name


def test_the_module_needs_nothing_and_names_its_law(module):
    content = module.read_bytes()
    assert library.law_hash().encode() in content
    program = (
        "const m = new WebAssembly.Module(require('fs').readFileSync(process.argv[1]));"
        "console.log(JSON.stringify(WebAssembly.Module.imports(m)))"
    )
    assert json.loads(node("-e", program, module)) == []


OPEN = """
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
const [, , module, wrapper, file, at] = process.argv;
const { loadLaw, Controller } = await import(pathToFileURL(wrapper));
const bytes = new Uint8Array(readFileSync(file));
if (at) bytes[Number(at)] ^= 1;
try { new Controller(await loadLaw(readFileSync(module)), bytes); console.log("taken"); }
catch (error) { console.log(error.message); }
"""


@parametrize(
    "at, words",
    {
        "": "taken",
        "5000": "the file is damaged: its checksum does not fit",
        "0": "the file is no controller",
    },
)
def test_a_damaged_file_is_refused_in_words(module, tmp_path, at, words):
    rig_of("two_contact_rod").controller().save(tmp_path / "controller.osc")
    (tmp_path / "open.mjs").write_text(OPEN)
    printed = node(tmp_path / "open.mjs", module, WRAPPER, tmp_path / "controller.osc", at)
    assert printed.strip() == words


LINK = """
from osc_contact.errors import OscContactError
from osc_contact.law import c_object, jit
units = jit.UNITS
roots = {"prepare": c_object._translated(c_object.osc_law_prepare)}
target = units.target_of("wasm32-unknown-wasi")
print(len(units.emit(roots, target)) > 1000)
units.link(roots, units.target_of("aarch64-linux-gnu"), plain=False)
try:
    units.link(roots, target, plain=False)
except OscContactError as error:
    print(error)
"""


def test_code_simplified_for_this_machine_is_refused_where_pointers_are_smaller():
    emitted, refused = python("-c", LINK, OSC_CONTACT_LAW="compile").stdout.splitlines()
    assert emitted == "True"
    assert (
        "was simplified for pointers of 8 bytes, and those of wasm32-unknown-wasi have 4" in refused
    )


def test_a_full_arena_of_the_quadratic_program_is_an_error(tmp_path):
    write_sources(tmp_path)
    checked = ["-std=c11", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-w"]
    sources = [tmp_path / "osc_daqp.c", Path(__file__).with_name("full_arena.c")]
    program = tmp_path / "full_arena"
    include = ["-I", tmp_path, "-I", tmp_path / "daqp" / "include"]
    completed("cc", *checked, *include, *sources, "-lm", "-o", program)
    assert completed(program).stdout == "3 full, 8 solved\n"

"""The law as WebAssembly: replayed in Node.js, refused where it would be wrong without an error."""

import json
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
from processes import completed, python
from pytest import mark
from rigs import rig_of
from samples import made_once, module_fixture, parametrize

import osc_contact as osc
from osc_contact.control.saving import controller_bytes
from osc_contact.control.web_assembly import MODULE, law_wasm
from osc_contact.control.without_python import write_sources
from osc_contact.lab.runs.run import start
from osc_contact.lab.runs.tape import Tape, build
from osc_contact.law import library
from osc_contact.law.jit import HAS_LIBRARY
from osc_contact.loop.loop import run_loop
from paper.selection_laws import (
    BASELINES,
    Instant,
    Selection,
    SelectionLaw,
    best_selection,
)

pytestmark = mark.skipif(not HAS_LIBRARY, reason="no library of the law is used here")
WRAPPER = Path(osc.__file__).parent / "control" / "web_files" / "controller.mjs"
REPLAY = Path(__file__).with_name("replay_in_node.mjs")
LARGEST = (
    1e-7  #: N m, of differences of torques; the same operations, other libraries of sin and atan2
)
TICKS = 1000
SHORT = 15  #: ticks, within which rounding stays rounding where things are learned from none


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


def test_recorded_ticks_of_every_scenario_are_those_of_the_compiled_law(module, tmp_path):
    names = sorted(osc.list_scenarios())
    for name in names:
        build(rig_of(name), tmp_path / name, ticks=TICKS)
    replayed = json.loads(node(REPLAY, module, WRAPPER, *(tmp_path / name for name in names)))
    for name, one in zip(names, replayed, strict=True):
        assert (one["ticks"], one["otherStatuses"]) == (TICKS, 0), name
        assert one["worst"] <= LARGEST < one["largest"], name
        assert ("1" in one["statuses"]) == (name == "limited_rod"), name


@parametrize("name", ["two_contact_rod", "panda_edge", "three_arm_plate"])
def test_a_selection_law_is_that_of_the_paper(module, tmp_path, name):
    """Five or six motions of the object, one, two or three axes."""
    rig = rig_of(name)
    law = best_selection(Instant(rig.state, rig.contact), BASELINES["khatib"], restarts=0)
    turned = pin.exp3(np.array([0.05, -0.1, 0.08]))  # of no contact
    selection = Selection(
        law.selection.point + 0.02, turned @ law.selection.forces, turned @ law.selection.couples
    )
    install = SelectionLaw(law.baseline, selection).install
    plant, controller = start(rig, install=install)
    (tmp_path / "controller.osc").write_bytes(controller_bytes(rig.controller()))
    (tmp_path / "selection.json").write_text(json.dumps(selection.as_dict()))
    tape = Tape(controller)
    references = rig.references.each(SHORT, controller.dt)
    run_loop(rig.robot(plant, controller), controller, references, check=False)
    (tmp_path / "recording.osc").write_bytes(tape.content())
    (one,) = json.loads(node(REPLAY, module, WRAPPER, tmp_path))
    assert (one["ticks"], one["otherStatuses"]) == (SHORT, 0)
    assert one["worst"] <= LARGEST < one["largest"]
    (tmp_path / "selection.json").unlink()
    (ours,) = json.loads(node(REPLAY, module, WRAPPER, tmp_path))
    assert ours["worst"] > 1e-3


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
from osc_contact.law import c_object, machine_code, platforms
roots = {"prepare": c_object._translated(c_object.osc_law_prepare)}
target = platforms.target_of("wasm32-unknown-wasi")
print(len(machine_code.emit(roots, target)) > 1000)
machine_code.link(roots, platforms.target_of("aarch64-linux-gnu"), plain=False)
try:
    machine_code.link(roots, target, plain=False)
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

"""Controllers' files from strangers: refused, or torques are finite and within their limits."""

import ctypes
from dataclasses import replace

import numpy as np
from crafted_files import BASES, FLOATS, KINDS, SOUND, Base, built, whole_fields
from numpy.random import default_rng
from processes import completed, python
from pytest import mark
from rigs import refused
from samples import aligned, first, module_fixture, parametrize
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.control import record_ranges
from osc_contact.control.record_ranges import NUMBERS, RELATIONS, broken_ranges, names_in
from osc_contact.control.saving import controller_bytes
from osc_contact.control.without_python import ERRORS, write_library
from osc_contact.lab.runs.run import start
from osc_contact.law import records
from osc_contact.law.jit import HAS_LIBRARY
from osc_contact.law.reasons import CODES

pytestmark = mark.skipif(not HAS_LIBRARY, reason="no library of the law is used here")
OUT_OF_RANGE, DAMAGED = (-list(ERRORS).index(name) for name in ("OUT_OF_RANGE", "DAMAGED"))
#: of mutations and of whole numbers: with the slow tests ten thousand, and all
SOME, FEW = 10_000, 400


@module_fixture
def program(tmp_path_factory):
    """Program of crafted.c with the library of the law."""
    folder = tmp_path_factory.mktemp("crafted")
    write_library(folder / "library")
    return built(folder / "library", folder)


@module_fixture
def rod(tmp_path_factory):
    return Base(tmp_path_factory.mktemp("rod"), "two_contact_rod", ticks=200)


# --- The declaration ------------------------------------------------------------------------------


def test_the_ranges_of_reasons_are_known_to_a_program_that_asks_for_them_first():
    """No module of the law has been imported before; a stopped controller could not be saved."""
    words = (
        "from osc_contact.control import record_ranges; print(record_ranges.RELATIONS['MEMORY'])"
    )
    assert f"reason <= {max(CODES.values())}" in python("-c", words).stdout


def test_every_whole_number_and_every_number_has_a_range():
    """A field that is added to a record needs one, or files could hold anything in it."""
    for name, kind in KINDS.items():
        for table, field in whole_fields(kind):
            relations = RELATIONS[name].get(table, ())
            assert any((field or table) in names_in(one) for one in relations), (name, table, field)
        for size in kind.counts:  # of MODEL's fields, or of others
            known = size in records.COUNTED and name != "PROGRAM"
            named = any(f"size_{size}" in names_in(one) for one in RELATIONS[name].get("", ()))
            assert known or named, (name, size)
    floats = {
        (name, table, field)
        for name in FLOATS
        for table, field, _ in record_ranges.number_ranges(name)
    }
    assert len(floats) > 150 and ("MEMORY", "torques", "torques") in floats
    for name, tables in NUMBERS.items():  # no range of what is not there
        assert all((name, table, field) in floats for table in tables for field in tables[table])


@parametrize(
    "table, field, value",
    [
        ("contacts", "phase", 3),
        ("joints", "faulty", -1),
        ("", "force_rank", 7),
        ("", "gap", -1),
        ("joints", "q", np.nan),
        ("torques", "", 1e4),
    ],
)
def test_a_number_that_no_file_may_hold_is_refused_when_it_is_saved(table, field, value):
    controller = start(rig_of("two_contact_rod"))[1]
    memory = controller.records.memory
    rows = getattr(memory, table).view(np.ndarray) if table else memory.head
    if field:
        rows[field] = value
    else:
        rows[:] = value
    with refused(f"MEMORY.*{field or table}"):
        controller_bytes(controller)


def test_a_controller_that_was_given_the_worst_can_still_be_saved():
    rig = rig_of("two_contact_rod")
    plant, controller = start(rig)
    m, r = plant.measure(), rig.references.at(0.0)
    rng = default_rng(3)
    words = [np.nan, np.inf, -np.inf, 1e308, -1e308, 1e150, 1e9, 1e3, 0.0]
    for k in range(400):
        if k % 40 == 0:
            controller.reset()
        q, v, w, V_D, A_D = (x.copy() for x in (m.q, m.v, m.wrenches, r.V_D, r.A_D))
        for x in (q, v, w, V_D, A_D):
            if rng.random() < 0.3:
                x.flat[rng.integers(x.size)] = rng.choice(words)
        bad = (osc.Measurement(q, v, w), replace(r, V_D=V_D, A_D=A_D))
        tau = controller.tick(*((m, r) if k % 3 == 0 else bad))
        assert (np.abs(tau) <= controller.chain.tau_max).all()
        if k % 20 == 19:
            controller_bytes(controller)


# --- Files ----------------------------------------------------------------------------------------


def test_an_address_in_a_file_is_refused(program, rod):
    """A pair of kind FUNCTION would call whatever is there."""
    first_pair = dict(rod.whole_numbers())
    kind, address = (first_pair[f"MODEL.pairs[0].{name}"] for name in ("kind", "address"))
    patches = [[(kind, records.FUNCTION), (address, 4096)], [(kind, records.FUNCTION)]]
    patches += [[(address, 4096)], [(kind, records.GIVEN)], []]
    assert rod.tried(program, patches) == [OUT_OF_RANGE] * 4 + [SOUND]


def drawn(items, count, seed):
    """Some of many."""
    return [items[i] for i in default_rng(seed).permutation(len(items))[:count]]


def test_no_word_that_places_something_may_be_another(program, rod):
    """Words are offsets of records and tables, and numbers of rows."""
    sizes = [
        f"MODEL.[0].{name}" for name in (*records.COUNTED.values(), "row_bytes", "memory_bytes")
    ]
    crafted = [
        (label, patch)
        for label, patch in rod.out_of_range()
        if ".layout" in label or "JOB." in label or label.partition(":")[0] in sizes
    ]
    some = drawn(crafted, 300, 4)
    endings = rod.tried(program, [patch for _, patch in some])
    accepted = [
        label for (label, _), end in aligned(some, endings) if end not in (DAMAGED, OUT_OF_RANGE)
    ]
    assert not accepted and len(endings) == 300


@parametrize("count", first([FEW, SOME], 1))
def test_random_words_lead_to_an_error_or_to_sound_torques(program, rod, count):
    """Floating-point numbers among them, one to three at a time; with a right checksum."""
    endings = rod.tried(program, rod.mutations(count, seed=7))
    assert len(endings) == count and max(endings) == SOUND
    assert 0.1 * count < endings.count(SOUND) < 0.9 * count


@parametrize("name", first(BASES, 1))
def test_whole_numbers_out_of_range_lead_to_an_error_or_to_sound_torques(
    program, tmp_path, name, request
):
    slow = request.node.get_closest_marker("slow") is not None
    base = Base(tmp_path / name, name, **BASES[name])
    crafted = base.out_of_range()
    crafted = crafted if slow else drawn(crafted, FEW, 5)
    endings = base.tried(program, [patch for _, patch in crafted])
    wrong = [label for (label, _), end in aligned(crafted, endings) if end > SOUND]
    assert not wrong and len(endings) == len(crafted)


def test_python_finds_out_of_range_what_c_does(program, rod):
    """Two readings of one declaration; where bytes begin, C only looks at."""
    places = [patch for label, patch in rod.out_of_range() if ".layout" not in label]
    patches = drawn([one for one in places if one[0][0] >= rod.starts["MODEL"] + 96], 150, 2)
    patches += [one for one in rod.mutations(200, seed=3) if not rod.moves(one)]
    agreed = 0
    for patch, end in aligned(patches, rod.tried(program, patches)):
        if end == DAMAGED:
            continue
        raw = rod.raw.copy()
        for at, word in patch:
            raw[at : at + 8] = np.frombuffer(np.int64(word).tobytes(), np.uint8)
        split = rod.starts["PROGRAM"]
        assert bool(broken_ranges(raw[:split], raw[split:])) == (end == OUT_OF_RANGE), patch
        agreed += 1
    assert agreed > 200


def test_memory_out_of_range_is_refused_as_in_a_file(program, rod):
    """A recording's: osc_set_memory takes what osc_get_memory gave, and no index beyond."""
    folder = program.parent / "library"
    completed("make", "-C", folder, "CFLAGS=-O1", "libosc_controller.so")
    c = ctypes.CDLL(str(folder / "libosc_controller.so"))
    handle = ctypes.c_void_p()
    assert c.osc_create(str(rod.folder / "controller.osc").encode(), ctypes.byref(handle)) == 0
    size = rod.starts["WORK"] - rod.starts["MEMORY"]
    memory = (ctypes.c_ubyte * size)()
    assert c.osc_get_memory(handle, memory, ctypes.c_size_t(size)) == 0
    assert c.osc_set_memory(handle, memory, ctypes.c_size_t(size)) == 0
    at = dict(rod.whole_numbers())["MEMORY.[0].force_rank"] - rod.starts["MEMORY"]
    memory[at] = 7
    assert c.osc_set_memory(handle, memory, ctypes.c_size_t(size)) == OUT_OF_RANGE
    c.osc_destroy(handle)

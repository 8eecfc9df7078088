"""Active sets of a controller with contact phases: the KKT oracle, and all ways of running it."""

import numpy as np
from numpy.testing import assert_array_equal
from phased_sets import RISE, made_for, packaged, phased, repeated
from processes import python
from pytest import mark
from samples import first, module_fixture, parametrize
from test_without_python import files, library, run  # noqa: F401

import osc_contact as osc
from osc_contact.lab.runs.tape import Tape
from osc_contact.law.jit import HAS_LIBRARY
from osc_contact.law.phases import APPROACHING, CLOSED, OPEN

COUNT = 300


@module_fixture
def sequence():
    """One sequence, in which contacts are made, lost, unloaded and replaced."""
    return phased(0, COUNT)


def judged(sequence):
    """Largest errors are rounding; contacts come and go by their rules, in every way."""
    assert max(sequence.errors.values()) < 1e-9, sequence.errors
    named, phases = (sequence.named, sequence.phases)
    unloaded = (phases != OPEN) & ~named
    assert (phases[named] != OPEN).all() and (phases[unloaded] == CLOSED).all()
    longest = np.zeros(named.shape[1], dtype=int)
    lasts = longest.copy()
    for k in range(len(named)):
        comes = k > 0 and (named[k] & (phases[k - 1] == OPEN)).any()
        assert not (comes and unloaded[k].any())  # they leave at once where another one comes
        lasts = (lasts + 1) * unloaded[k]
        longest = np.maximum(longest, lasts)
    steps = 2.0 * RISE / 1e-3 + 2  # steps of other forces may lengthen it to this
    assert 0 < longest.max() <= steps
    seen = {(int(a), int(b)) for a, b in zip(phases[:-1].flat, phases[1:].flat, strict=True)}
    both = {APPROACHING, CLOSED}
    assert {(a, b) for a in both for b in both} | {(OPEN, a) for a in both} <= seen
    assert {(a, OPEN) for a in both} <= seen


def test_forces_and_motion_of_the_contacts_that_the_phases_leave(sequence):
    judged(sequence)


@mark.slow
@parametrize("seed", [1, 2])
def test_a_thousand_ticks_of_phases(seed):
    judged(phased(seed, 1000))


def repeated_in_c(program, sequence, reading, folder):
    """Assert that `program`, which replays in C, has the torques of a sequence."""
    controller = made_for(sequence.scene, reading)
    controller.save(folder / "controller.osc")
    tape = Tape(controller)
    for tick in sequence.ticks:
        controller.tick(tick.measured, tick.reference)
    (folder / "recording.osc").write_bytes(tape.content())
    count = len(sequence.ticks)
    printed = run(program, *files(folder))
    assert printed.startswith(f"{count} of {count} ticks bit-equal") and " 0 HELD" in printed


@mark.skipif(not HAS_LIBRARY, reason="no library of the law is used here")
@parametrize("count", first([COUNT, 1000], 1))
@parametrize("reading", ["filter", "least_squares"])
def test_all_ways_are_equal_to_the_bit(library, reading, count, tmp_path):  # noqa: F811
    """Objects, plain Python, C and batches, beside the controller that the sequence was made by."""
    seed = packaged(3)
    sequence = phased(seed, count, reading)
    inputs = sequence.arrays()
    assert_array_equal(repeated(made_for(sequence.scene, reading), inputs), sequence.tau)
    repeated_in_c(library / "replay", sequence, reading, tmp_path)
    batch = osc.BatchController([made_for(sequence.scene, reading) for _ in range(2)], threads=2)
    for k, tau in enumerate(sequence.tau):
        given = {name: np.stack([values[k]] * 2) for name, values in inputs.items()}
        places = [given.pop(name) for name in ("q", "v", "wrenches", "X_WD")]
        assert_array_equal(batch.tick(*places, **given), [tau, tau])
    np.savez(tmp_path / "inputs.npz", **inputs)
    words = "import sys; from phased_sets import repeat; repeat(int(sys.argv[1]), *sys.argv[2:])"
    outputs = tmp_path / "tau.npy"
    python("-c", words, seed, reading, tmp_path / "inputs.npz", outputs, NUMBA_DISABLE_JIT="1")
    assert_array_equal(np.load(outputs), sequence.tau)

"""The compiled law touches only the bytes it is given: each part lies between guard pages."""

import ctypes
import mmap
import signal
from dataclasses import replace

import numpy as np
from numpy.testing import assert_array_equal
from processes import python
from pytest import mark
from rigs import rig_of
from samples import aligned

import osc_contact as osc
from benchmarks.tick import ALL_CASES
from osc_contact.control.inputs import touched_rows
from osc_contact.lab.runs.run import start
from osc_contact.law import jit, records, tick
from osc_contact.law.compiled import rows
from osc_contact.law.limits import PROGRAM, TorqueLimits
from osc_contact.law.saturation import fill_program, settle

MOVING = "moving_face"  #: bodies that move
MARGIN = 1 << 20  #: bytes on both sides that must not be touched

NO_ACCESS = 0

kept = []


def guarded(content, at_end, writable=True, beyond=0):
    """A copy that begins or ends at a page without access.

    Args:
        content: array.
        at_end: whether it ends there.
        writable: or a write is a fault, too.
        beyond: bytes by which it lies too far.
    """
    content = np.ascontiguousarray(content)
    size = -(-max(content.nbytes, 1) // mmap.PAGESIZE) * mmap.PAGESIZE
    pages = mmap.mmap(-1, MARGIN + size + MARGIN)
    kept.append(pages)
    at = MARGIN + (size - content.nbytes if at_end else 0) + beyond
    whole = np.frombuffer(pages, np.uint8)
    whole[at : at + content.nbytes] = content.view(np.uint8).ravel()
    found = whole[at : at + content.nbytes].view(content.dtype).reshape(content.shape)
    first = ctypes.addressof(ctypes.c_char.from_buffer(pages))
    protect(first, MARGIN, NO_ACCESS)
    protect(first + MARGIN + size, MARGIN, NO_ACCESS)
    if not writable:
        protect(first + MARGIN, size, mmap.PROT_READ)
    return found


def protect(address, size, access):
    libc = ctypes.CDLL(None, use_errno=True)
    assert libc.mprotect(ctypes.c_void_p(address), ctypes.c_size_t(size), access) == 0


class Guarded:
    """A controller whose records, program, readings and references lie apart from one another."""

    def __init__(self, controller, at_end, beyond):
        rows = controller.records.rows
        self.at_end = at_end
        self.job = guarded(rows.jobs[0], at_end)
        head = records.JOB.view(self.job)
        base = self.job.ctypes.data
        parts = {}
        for name in ("model", "memory", "work", "input"):
            shift = beyond if name == "work" else 0
            part = guarded(getattr(rows, name)[0], at_end, name != "model", shift)
            setattr(head, name, part.ctypes.data - base)
            parts[name] = part
        self.memory = records.MEMORY.view(parts["memory"])
        model = records.MODEL.view(parts["model"])
        sizes = (int(model.n_motors), max(1, int(model.n_columns)), int(model.n_extra))
        limits = TorqueLimits(*sizes, 8)
        limits.program.mass = controller.chain.reference.inertia.mass
        limits.raw = guarded(limits.raw, at_end)
        limits.program = PROGRAM.view(limits.raw)
        self.limits = limits

    def tick(self, m, reference):
        """Status and torques."""
        flags = 0
        touched = np.zeros((0, 28))
        if m.touched is not None:
            flags |= tick.MOVING
            touched = touched_rows(m.touched)
        self.memory.wrench_missing = int(not m.wrench_valid)
        self.memory.squeeze[:] = squeeze = reference.squeeze_d
        if len(m.wrenches) > 2 and np.any(squeeze):
            flags |= tick.COMMANDED
        X = reference.X_WD.homogeneous
        alpha = np.asarray(reference.alpha_d, dtype=float)
        active = np.zeros(0) if reference.active is None else reference.active
        given = (m.q, m.v, m.wrenches, X, reference.V_D, reference.A_D, alpha, touched, active)
        job = records.JOB.view(self.job)
        job.switches = flags
        rows()(self.job, 0, tuple(guarded(x, self.at_end, writable=False) for x in given))
        job.switches = 0
        if self.memory.status == osc.Status.SATURATED:
            fill_program(self.job, 0, 0, self.limits.raw)
            self.limits.solve()
            settle(self.job, 0, 0, self.limits.raw)
        return (osc.Status(int(self.memory.status)), np.array(self.memory.torques))


def prepared(name):
    """A controller, a measurement, and a reference."""
    if name == MOVING:
        rig = rig_of(name)
        plant, controller = start(rig)
        return (controller, plant.measure(), rig.references.at(0.0))
    case = ALL_CASES[name]()
    return (case.controller(), *case.given)


def tick_between_guards(name, at_end, beyond=0):
    """Ticks of two controllers, one between guard pages, are the same. Prints how they ended."""
    print(name, end=" ", flush=True)  # which one it was if the process ends
    controller, m, reference = prepared(name)
    controller.tick(m, reference)
    other = Guarded(controller, at_end, beyond)
    rng = np.random.default_rng(3)
    seen = set()
    for k in range(30):
        q = m.q + 1e-4 * rng.standard_normal(len(m.q)) * (np.nan if k % 10 == 7 else 1.0)
        given = replace(m, q=q, wrench_valid=k % 9 != 5)
        tau = controller.tick(given, reference)
        status, torques = other.tick(given, reference)
        assert status is controller.status, (k, status, controller.status)
        assert_array_equal(torques, tau)
        seen.add(status.name)
        if controller.state is osc.SafetyState.SAFE_STOP:
            break
    print(*sorted(seen), flush=True)


NAMES = (
    "two_contact_rod",
    "one_panda",
    "near_singular",
    "saturated",
    "three_arms",
    "contact_phases",
    MOVING,
)


def run(names, *sides, code=0):
    """Lines printed for each name and side in a separate process, which an access outside ends."""
    words = f"[t.tick_between_guards(name, *side) for name in {names!r} for side in {sides!r}]"
    done = python("-c", f"import test_guarded_memory as t; {words}", code=code)
    return [line.split() for line in done.stdout.splitlines()]


def test_no_tick_reads_or_writes_outside_of_its_records():
    """Neither behind nor before them."""
    lines = run(NAMES, (True,), (False,))
    for name, behind, before in aligned(NAMES, lines[::2], lines[1::2]):
        assert behind[0] == name and before == behind
        assert "HELD" in behind and len(behind) >= 3


@mark.skipif(jit.PLAIN_PYTHON, reason="arrays of NumPy end where they end")
def test_records_too_near_to_the_guard_are_noticed():
    run(NAMES[:1], (True, 4096), code=-signal.SIGSEGV)

"""Bytes of stack that one tick of the compiled law touches, case by case.

    python -m benchmarks.stack

Threads in real time often have small stacks. The law runs in a thread whose stack is filled with a
pattern, so that the deepest byte that a tick overwrites is found, less that of an empty thread.
Needs a C compiler.
"""

import ctypes
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.cases import CASES, SPECIAL_CASES, TickCase
from osc_contact.control.records import STILL, UNNAMED
from osc_contact.law import library
from osc_contact.law.c_object import object_file

ROOM = 1 << 20  #: bytes of the thread's stack
#: Cases whose tick is one call of the law.
PLAIN = [*CASES, "near_singular", "saturated", "three_arms", "contact_phases"]
SOURCE = """
#include <pthread.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

int32_t osc_law_rows(int64_t *, void **, uintptr_t, int64_t, uintptr_t, uintptr_t);

static uintptr_t given[3];

static void *empty(void *unused) { return unused; }

static void *tick(void *unused) {
    int64_t done;
    osc_law_rows(&done, &unused, given[0], 0, given[1], given[2]);
    return unused;
}

static long touched(void *(*run)(void *), size_t room) {
    pthread_attr_t attributes;
    pthread_t thread;
    unsigned char *stack;
    size_t left = 0;
    if (posix_memalign((void **)&stack, 4096, room)) return -1;
    memset(stack, 0xA5, room);
    pthread_attr_init(&attributes);
    if (pthread_attr_setstack(&attributes, stack, room)) return -1;
    if (pthread_create(&thread, &attributes, run, NULL)) return -1;
    pthread_join(thread, NULL);
    while (left < room && stack[left] == 0xA5) left++;
    free(stack);
    return (long)(room - left);
}

long stack_of_tick(uintptr_t raw, uintptr_t arrays, uintptr_t sizes, size_t room) {
    long before;
    given[0] = raw;
    given[1] = arrays;
    given[2] = sizes;
    before = touched(empty, room);
    return before < 0 ? before : touched(tick, room) - before;
}
"""


def harness(folder: Path) -> Any:
    """`stack_of_tick`, linked with the object file of the law.

    Args:
        folder: for the files that this takes.
    """
    (folder / "law.o").write_bytes(object_file())
    (folder / "stack.c").write_text(SOURCE)
    made = folder / "stack.so"
    command = [library.COMPILER, "-O1", "-shared", "-fPIC", "-pthread"]
    command += [
        str(folder / "stack.c"),
        str(folder / "law.o"),
        "-lm",
        "-Wl,-z,now",
        "-o",
        str(made),
    ]
    subprocess.run(command, check=True)
    call = ctypes.CDLL(str(made)).stack_of_tick
    call.restype = ctypes.c_long
    call.argtypes = [ctypes.c_void_p] * 3 + [ctypes.c_size_t]
    return call


def stack_of(case: TickCase, call: Any) -> int:
    """Number of bytes of the stack that a tick uses, after a tick that sets the initial state.

    Args:
        case: case with one controller.
        call: from `harness`.
    """
    controller = case.controller()
    (m, r) = case.given
    controller.tick(m, r)
    given = (m.q, m.v, m.wrenches, r.X_WD.homogeneous, r.V_D, r.A_D, r.alpha_d, STILL, UNNAMED)
    arrays = [np.ascontiguousarray(one, dtype=float) for one in given]
    addresses = np.array([one.ctypes.data for one in arrays])
    sizes = np.array([len(one) if one.ndim > 1 else one.size for one in arrays])
    raw = controller.records.rows.raw
    found = call(raw.ctypes.data, addresses.ctypes.data, sizes.ctypes.data, ROOM)
    assert 0 < found < ROOM // 2, f"{found} bytes: no stack could be made"
    assert controller.records.work.reason == 0, "the tick was not computed"
    return int(found)


def main() -> None:
    """Print the bytes of each case, the largest last."""
    cases = {**CASES, **SPECIAL_CASES}
    with TemporaryDirectory() as folder:
        call = harness(Path(folder))
        found = {name: stack_of(cases[name](), call) for name in PLAIN}
    for name, size in found.items():
        print(f"{name:20}{size:8,} bytes")
    print(f"{'largest':20}{max(found.values()):8,} bytes")


if __name__ == "__main__":
    main()

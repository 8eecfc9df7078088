"""Files of controllers with some words replaced, and their reading by a C program.

    python tests/crafted_files.py [MUTATIONS [SEED]]

tries other values for every whole number, and a number of random mutations.
"""

import struct
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.random import default_rng
from processes import completed
from scenario_runs import rig_of

import osc_contact as osc
from osc_contact.control.record_ranges import RECORDS as KINDS
from osc_contact.control.saving import HEAD, controller_bytes
from osc_contact.control.without_python import write_library
from osc_contact.lab.runs.run import start
from osc_contact.lab.runs.tape import Tape
from osc_contact.law import records

FLAGS = ("-std=gnu11", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-w")
#: results of the C program for a file that is accepted; below 1: error codes
SOUND, WRONG_TORQUES, OVERWRITTEN, CRASHED, ENDLESS = range(1, 6)
ENDINGS = ("", "sound", "wrong torques", "overwritten", "crashed", "endless")
FLOATS = ("MODEL", "MEMORY")  #: records whose floating-point numbers have ranges
#: extreme whole and floating-point numbers that mutations insert
WHOLE = (-(1 << 63), -(1 << 31), -2, -1, 0, 1, 2, 3, 4, 5, 6, 7, 17, 1000, 1 << 20, 1 << 40)
NUMBERS = (np.nan, np.inf, -np.inf, 1.8e308, -1.8e308, 1e300, -1e300, 1e150, -1e150, 1e30, -1e30)
NUMBERS += (1e9, -1e9, 1e3, -1e3, 1.0, -1.0, 0.0, -0.0, 1e-9, 1e-300, -1e-300, 5e-324)


def whole_fields(kind):
    """List table and field ("": the element itself) of all whole numbers except the layout."""
    heads = {"": kind.dtype, **{table: dtype for table, (dtype, _) in kind.tables.items()}}
    return [
        (table, field)
        for table, dtype in heads.items()
        for field in dtype.names or ("",)
        if field != "layout" and (dtype[field] if field else dtype).base.kind == "i"
    ]


def on_spline(controller):
    """Variant of the controller whose sphere is a surface of spline cells."""
    own = controller.settings
    (pair,) = own.contacts
    radius = 1.0 / pair.surface.bend[0]
    x, y = 0.6 * abs(radius) * np.array(np.meshgrid(*[np.linspace(-1, 1, 20)] * 2)).reshape(2, -1)
    top = np.sign(radius) * np.sqrt(radius**2 - x**2 - y**2)
    surface = osc.Surface.fitted(np.array([x, y, top]).T, (2, 3))
    seat = (pair.surface_point, pair.surface_axis, pair.surface_x)
    return osc.Controller(
        own.chain,
        [osc.SphereOnSurface(pair.centre, pair.radius, surface, *seat)],
        own.gains,
        dt=own.dt,
        posture=own.posture,
        friction=own.friction,
    )


class Base:
    """File of a controller and a recording of the next ticks, in a folder.

    Attributes:
        content: bytes of the file.
        raw: its records.
        starts: offset of each record in `raw`.
        folder: the folder.
    """

    def __init__(
        self, folder: Path, name: str, ticks: int, blind: int = 0, spline: bool = False
    ) -> None:
        """Run a scenario and save the controller.

        Args:
            folder: folder, which is made.
            name: name of the scenario.
            ticks: number of ticks.
            blind: number of last ticks without joint readings.
            spline: True: a spline surface replaces the scenario's sphere.
        """
        rig = rig_of(name)
        plant, controller = start(rig)
        if spline:
            controller = on_spline(controller)

        def tick(k: int, blind: bool) -> None:
            """Run tick k; `blind`: without joint readings."""
            m = plant.measure()
            if blind:
                m = replace(m, q=m.q * np.nan)
            plant.command(controller.tick(m, rig.references.at(1e-3 * k)), controller.dt)

        for k in range(ticks):
            tick(k, k >= ticks - blind)
        self.content = controller_bytes(controller)
        tape = Tape(controller)
        for k in range(8):
            tick(ticks + k, False)
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "controller.osc").write_bytes(self.content)
        (folder / "recording.osc").write_bytes(tape.content())
        raw = np.frombuffer(self.content, np.uint8)[HEAD:-4]
        job = records.JOB.view(raw)
        self.starts = {"JOB": 0}
        self.starts |= {n: int(getattr(job, n.lower())) for n in list(KINDS)[1:5]}
        self.starts["PROGRAM"] = int.from_bytes(self.content[80:88], "little")
        self.raw = raw

    def word(self, at: int) -> int:
        """Word (64 bit) at an offset in the records."""
        return int(self.raw[at : at + 8].view(np.int64)[0])

    def whole_numbers(self) -> list[tuple[str, int]]:
        """List name and offset of every whole number, layouts included."""
        found = []
        for name, first in self.starts.items():
            kind = KINDS[name]
            layout = self.raw[first:].view(np.int64)
            heads = {"": (kind.dtype, first, 1)}
            for table, (dtype, sizes) in kind.tables.items():
                rows = [int(layout[kind.slot(x)]) if isinstance(x, str) else x for x in sizes]
                heads[table] = (dtype, first + int(layout[kind.start(table)]), int(np.prod(rows)))
            for table, (dtype, begin, rows) in heads.items():
                for field in dtype.names or ("",):
                    item, offset = dtype.fields[field][:2] if field else (dtype, 0)
                    if item.base != np.int64:
                        continue
                    for row in range(rows):
                        at = begin + row * dtype.itemsize + offset
                        label = f"{name}.{table}[{row}].{field}"
                        found += [(label, at + 8 * i) for i in range(item.itemsize // 8)]
        return found

    def moves(self, patch: list[tuple[int, int]]) -> bool:
        """True if a patch, a list of (offset, word), changes the place of records or tables."""
        layout = {at for label, at in self.whole_numbers() if "layout" in label or "JOB" in label}
        layout |= set(range(self.starts["MODEL"] + 96, self.starts["MODEL"] + 280, 8))
        return any(at in layout for at, _ in patch)

    def mutations(self, count: int, seed: int) -> list[list[tuple[int, int]]]:
        """List random patches, each of which replaces one to three words of records.

        Args:
            count: number of patches.
            seed: seed of the random numbers.
        """
        rng = default_rng(seed)
        ends = dict(zip(self.starts, [*list(self.starts.values())[1:], len(self.raw)], strict=True))
        whole = [at for _, at in self.whole_numbers()]
        found = []
        for _ in range(count):
            patch = []
            for _ in range(rng.integers(1, 4)):
                name = rng.choice(["JOB", "MODEL", "MODEL", "MEMORY", "MEMORY", "WORK", "PROGRAM"])
                at = int(rng.integers(self.starts[name], ends[name]) // 8 * 8)
                at = int(rng.choice(whole)) if rng.random() < 0.2 else at
                old = self.word(at)
                match rng.integers(6):
                    case 0:
                        new = old ^ (1 << int(rng.integers(63)))
                    case 1:
                        new = int(rng.integers(-(1 << 63), (1 << 63) - 1))
                    case 2:
                        new = int(rng.choice(WHOLE))
                    case 3:
                        new = old + int(rng.integers(-3, 4))
                    case 4:
                        new = _as_word(float(rng.choice(NUMBERS)))
                    case _:
                        scale = 10.0 ** rng.uniform(-12, 12) * rng.choice([-1, 1])
                        new = _as_word(scale * (_as_number(old) or 1.0))
                patch.append((at, _wrapped(new)))
            found.append(patch)
        return found

    def out_of_range(self) -> list[tuple[str, list[tuple[int, int]]]]:
        """List name and patch for every whole number and each of several other values of it."""
        found = []
        for name, at in self.whole_numbers():
            old = self.word(at)
            for new in {*WHOLE[:4], *WHOLE[-3:], (1 << 63) - 1, old + 1, old - 1, old + 64}:
                if new != old:
                    found.append((f"{name}: {old} -> {new}", [(at, _wrapped(new))]))
        return found

    def tried(self, program: Path, patches: list[list[tuple[int, int]]]) -> list[int]:
        """Run the C program for each patch; return its results, see `ENDINGS`.

        Args:
            program: the C program.
            patches: lists of (offset, word).
        """
        words = []
        for patch in patches:
            words.append(struct.pack("<Q", len(patch)))
            words += [struct.pack("<Qq", *word) for word in patch]
        path = self.folder / "patches"
        path.write_bytes(b"".join(words))
        files = [self.folder / "controller.osc", self.folder / "recording.osc"]
        done = completed(program, *files, path, timeout=3000)
        return [int(line) for line in done.stdout.split()]


def _as_word(x: float) -> int:
    """Word with the bits of a floating-point number."""
    return int(struct.unpack("<q", struct.pack("<d", x))[0])


def _as_number(word: int) -> float:
    """Floating-point number with the bits of a word; 1 for numbers that are not finite."""
    x = float(struct.unpack("<d", struct.pack("<q", word))[0])
    return x if np.isfinite(x) else 1.0


def _wrapped(word: int) -> int:
    """Signed 64-bit number equal to a whole number modulo 2⁶⁴."""
    return (word + (1 << 63)) % (1 << 64) - (1 << 63)


def built(library: Path, folder: Path) -> Path:
    """Compile the C program with the C library in the folder `library`; return its path."""
    include = ["-I", library, "-I", library / "daqp" / "include"]
    solver, program = folder / "osc_daqp.o", folder / "crafted"
    completed("cc", *FLAGS, *include, "-c", library / "osc_daqp.c", "-o", solver)
    sources = [Path(__file__).with_name("crafted.c"), library / "recording.c", library / "law.o"]
    completed("cc", *FLAGS, "-O1", *include, *sources, solver, "-lm", "-o", program)
    return program


#: Scenarios: at the start, in contact, with motor limits, moving bodies, phases, holds and stops.
BASES = {
    "two_contact_rod": {"ticks": 200},
    "three_arm_plate": {"ticks": 50},
    "limited_rod": {"ticks": 300},
    "moving_face": {"ticks": 100},
    "approach_and_slide": {"ticks": 600},
    "panda_dome": {"ticks": 100, "spline": True},
    "scara_peg": {"ticks": 0},
    "panda_edge": {"ticks": 60, "blind": 6},
    "dual_panda_rod": {"ticks": 80, "blind": 30},
    "hinge_ball_rod": {"ticks": 40},
}


def main(count: int = 10_000, seed: int = 1) -> int:
    """Try all patches of all scenarios and print the results; return 1 if a file did harm."""
    total: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_library(folder)
        program = built(folder, folder)
        for scenario, how in BASES.items():
            begun = time.monotonic()
            base = Base(folder / scenario, scenario, **how)
            whole = base.out_of_range()
            random = base.mutations(count // len(BASES), seed + len(total))
            for kind, patches in (("whole", [patch for _, patch in whole]), ("random", random)):
                endings = base.tried(program, patches)
                found = Counter("refused" if x < 1 else ENDINGS[x] for x in endings)
                total.update({f"{kind} numbers: {x}": n for x, n in found.items()})
                print(f"{scenario}, {kind}: {dict(found)}", flush=True)
                for ending, patch in zip(endings, patches, strict=True):
                    if ending > SOUND:
                        print(f"    {ENDINGS[ending]}: {patch}")
            print(f"    {time.monotonic() - begun:.0f} s", flush=True)
    print(dict(total))
    return int(any(not x.endswith(("refused", "sound")) for x in total))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))

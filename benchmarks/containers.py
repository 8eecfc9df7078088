"""Which file survives a kill: containers for recordings, killed at random moments.

    python benchmarks/containers.py [KILLS]

A process appends chunks of 100 rows of 120 numbers, hands each to the operating system and says so;
then it is killed. Counted are the files that can still be read and the chunks lost of those
reported. Containers whose packages (pyarrow) are not installed are left out.
"""

import random
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from time import sleep
from typing import Any

import numpy as np

ROWS = 100
NUMBERS = 120


def write(kind: str, path: Path) -> None:
    """Append chunks for ever."""
    put = KINDS[kind][1](path)
    for k in count():
        put(k, np.full((ROWS, NUMBERS), float(k)))
        print(k + 1, flush=True)


def _mcap(path: Path) -> Any:
    from osc_contact.recorder.journal import JournalFile

    journal = JournalFile(path, {})
    row = np.dtype([("x", "<f8", (NUMBERS,))])
    return lambda k, rows: journal.append(k * ROWS, np.ndarray(ROWS, row, rows))


def _arrow(path: Path) -> Any:
    import pyarrow as pa

    kind = pa.schema([("x", pa.list_(pa.float64(), NUMBERS))])
    file = open(path, "wb", buffering=0)  # noqa: SIM115 (it is killed)
    stream = pa.ipc.new_stream(file, kind)

    def put(k: int, rows: Any) -> None:
        flat = pa.FixedSizeListArray.from_arrays(pa.array(rows.ravel()), NUMBERS)
        stream.write_batch(pa.record_batch([flat], schema=kind))

    return put


def _npz(path: Path) -> Any:
    kept: list[Any] = []

    def put(k: int, rows: Any) -> None:
        kept.append(rows)
        if k % 20 == 19:  # all of it, again and again
            np.savez(path, x=np.concatenate(kept))

    return put


KINDS = {"mcap": ("mcap", _mcap), "arrow": ("pyarrow", _arrow), "npz": ("numpy", _npz)}


def chunks_in(kind: str, path: Path) -> int:
    """Chunks that hold what was written; an error: the file cannot be read."""
    if kind == "mcap":
        from osc_contact.recorder.journal import Journal

        parts = [rows["x"] for _, rows in Journal(path).rows()]
    elif kind == "arrow":
        import pyarrow as pa

        parts = []
        try:
            for batch in pa.ipc.open_stream(str(path)):
                parts.append(batch["x"].flatten().to_numpy().reshape(ROWS, NUMBERS))
        except (pa.ArrowInvalid, OSError):  # where it was cut off
            if not parts:
                raise
    else:
        x = np.load(path)["x"]
        parts = [x[i : i + ROWS] for i in range(0, len(x), ROWS)]
    wrong = (k for k, rows in enumerate(parts) if not (len(rows) == ROWS and (rows == k).all()))
    return next(wrong, len(parts))


def main(kills: int) -> None:
    """Print a line for each container."""
    rng = random.Random(1)
    for kind, (package, _) in KINDS.items():
        if find_spec(package) is None:
            print(f"{kind}: {package} is not installed")
            continue
        unreadable: list[str] = []
        lost: list[int] = []
        for _ in range(kills):
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"run.{kind}"
                command = [sys.executable, __file__, "--write", kind, str(path)]
                with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
                    process.stdout.readline()  # type: ignore[union-attr]
                    sleep(rng.uniform(0.0, 0.2))
                    process.kill()
                    said = [1, *map(int, process.communicate()[0].split())][-1]
                try:
                    lost.append(max(0, said - chunks_in(kind, path)))
                except Exception as error:  # whatever a container's reader ends in is the result
                    unreadable.append(type(error).__name__)
        ends = f" ({', '.join(sorted(set(unreadable)))})" if unreadable else ""
        print(
            f"{kind}: {kills} kills, {len(unreadable)} unreadable{ends}, "
            f"{max(lost, default=0)} chunks lost at most",
            flush=True,
        )


if __name__ == "__main__":
    if sys.argv[1:2] == ["--write"]:
        write(sys.argv[2], Path(sys.argv[3]))
    else:
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)

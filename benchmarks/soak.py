"""Half an hour of control, twice: does memory grow, are the recordings the same bit for bit?

    python -m benchmarks soak [--ticks 1800000]

Each run has a process of its own, and records as every run does. Memory is what the kernel counts
for the process, from a tenth of the run on to its last tick, and at its most until the recording
has been read through.
"""

import json
import resource
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import osc_contact as osc
from paper.study import Data

SCENARIO = "two_contact_rod"
RUNS = 2
CLOCKED = "tick_s"  #: the only channel that differs from run to run


def soak(ticks: int) -> Data:
    """One run, in this process: memory (MB) and a hash of all channels that no clock made."""
    scenario = osc.load_scenario(SCENARIO)
    duration = ticks / scenario.control.rate
    held = []

    def progress(now: float) -> None:
        if now >= 0.1 * duration:
            held.append(resident())

    recording = osc.run(scenario, duration=duration, progress=progress)
    names = [name for name in recording.channels if name != CLOCKED]
    found = sha256()
    for piece in recording.pieces(*names):
        for name in names:
            found.update(piece[name].tobytes())
    return {
        "ticks": len(recording),
        "begin_MB": held[0],
        "grown_MB": max(held) - held[0],
        "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "hash": found.hexdigest()[:16],
        "end": recording.meta["end_state"],
    }


def resident() -> float:
    """Memory of this process (MB)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def measure(ticks: int) -> Data:
    """Both runs, one after the other: memory and hash of each."""
    _run(1000)  # compiles, where that is still to be done
    return {"runs": [_run(ticks) for _ in range(RUNS)]}


def _run(ticks: int) -> Data:
    words = [sys.executable, "-m", "benchmarks.soak", str(ticks)]
    return dict(json.loads(subprocess.check_output(words)))


if __name__ == "__main__":
    print(json.dumps(soak(int(sys.argv[1]))))

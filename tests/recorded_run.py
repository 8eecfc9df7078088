"""A run in a process of its own, to be killed, interrupted, starved of disk, or compared.

python tests/recorded_run.py FOLDER DURATION [PLANT]
"""

import sys
from pathlib import Path

import osc_contact as osc

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    duration = float(sys.argv[2])
    plant = sys.argv[3] if len(sys.argv) > 3 else "mujoco"
    scenario = osc.load_scenario("two_contact_rod", [f"plant.type={plant}"])
    tell = lambda t: print(t, flush=True)  # noqa: E731
    recording = osc.run(
        scenario, duration=duration, seed=3, progress=tell, journal=folder / "unfinished.mcap"
    )
    recording.save(folder / "recording.npz")
    print(len(recording), *recording.meta.get("missing", ()))

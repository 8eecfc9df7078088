"""The figures of a run: contact forces, power, tracking and torques, PNG and SVG.

They are half of what is left to do once a run has ended. `FigureProcess` draws them in a process
that imports matplotlib while the run lasts, and draws while the scene is written.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

from osc_contact.recorder import Recording
from osc_contact.recorder.judged import SETTLE_S, judged_ticks

RECORDING = "recording.npz"  #: the name of a run's recording in its folder
DRAWN = 50_000  #: ticks; of longer recordings every second, third, … one is drawn


def draw_figures(recording: Recording, folder: Path) -> None:
    """Draw all figures of a run.

    Args:
        recording: of the run. folder: for the files.
    """
    from osc_contact.visual import plots

    recording = recording.thinned(DRAWN)
    forces, whole = judged_ticks(recording)
    if recording.meta["contact_names"]:
        plots.save(plots.contact_forces(recording, forces), folder / "contact_forces")
    plots.save(plots.power(recording, whole), folder / "power")
    plots.save(plots.tracking(recording, SETTLE_S), folder / "tracking")
    plots.save(plots.torques(recording), folder / "torques")


class FigureProcess:
    """A process that draws the figures of a run, beside this one.

    It ends with the block, and with this process however that ends.
    """

    def __enter__(self) -> "FigureProcess":
        """Start it: it imports what it needs, and waits for a folder."""
        command = [sys.executable, "-P", "-m", __name__]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.communicate()

    def begin(self, folder: Path) -> None:
        """Have the figures of the recording in a folder drawn into it."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(f"{folder.resolve()}\n")
            self._process.stdin.flush()
        except OSError:  # it has ended, which `finish` notices
            pass

    def finish(self) -> bool:
        """Wait for it; whether the figures are drawn."""
        return self._process.wait() == 0


def _draw_on_request() -> None:
    """Draw the figures of the recording in the folder that the input names, if it names one.

    Ctrl-C is for the run: it ends in order, and what is there is drawn.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from osc_contact.visual import plots  # noqa: F401

    folder = sys.stdin.readline().rstrip("\n")
    if folder:
        draw_figures(Recording.load(os.path.join(folder, RECORDING)), Path(folder))


if __name__ == "__main__":
    _draw_on_request()

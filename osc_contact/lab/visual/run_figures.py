"""The figures of a run: contact forces, power, tracking and torques, PNG and SVG.

They take most of the time after the end of a run. `FigureProcess` draws them in a process
that imports matplotlib while the run lasts, and draws while the scene is written.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from osc_contact.recorder import Recording
from osc_contact.recorder.judged import SETTLE_S, judged_ticks

RECORDING = "recording.npz"  #: the name of a run's recording in its folder
DRAWN = 50_000  #: ticks; of longer recordings every second, third, … one is drawn


#: Names of the figures, in shares that take about equally long.
SHARES = (("contact_forces", "torques"), ("power", "tracking"))


def draw_figures(recording: Recording, folder: Path, names: Sequence[str] | None = None) -> None:
    """Draw figures of a run.

    Args:
        recording: recording of the run.
        folder: folder for the files.
        names: names of the figures; None: all. That of contact forces needs contacts.
    """
    from osc_contact.lab.visual import plots

    recording = recording.thinned(DRAWN)
    forces, judged_motion = judged_ticks(recording)
    drawings = {
        "contact_forces": partial(plots.contact_forces, recording, forces),
        "power": partial(plots.power, recording, judged_motion),
        "tracking": partial(plots.tracking, recording, SETTLE_S),
        "torques": partial(plots.torques, recording),
    }
    if not recording.meta["contact_names"]:
        del drawings["contact_forces"]
    for name, draw in drawings.items():
        if names is None or name in names:
            plots.save(draw(), folder / name)


class FigureProcess:
    """A process that draws the figures of a run, beside this one.

    It ends with the block, and with this process however that ends.
    """

    def __enter__(self) -> "FigureProcess":
        """Start the process, which imports its modules and waits for a folder."""
        command = [sys.executable, "-P", "-m", __name__]
        #: process that draws the figures
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        return self

    def __exit__(self, *_: object) -> None:
        """End the process; figures that are not finished are not drawn."""
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

    Ctrl-C is for the run: it ends in order, and the ticks so far are drawn. A second process, which
    need not import anything, draws its share of them meanwhile.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from osc_contact.lab.visual import plots  # noqa: F401

    folder = sys.stdin.readline().rstrip("\n")
    if folder:
        recording = Recording.load(os.path.join(folder, RECORDING))
        mine, second_share = SHARES
        other = get_context("fork").Process(
            target=draw_figures, args=(recording, Path(folder), second_share)
        )
        other.start()
        draw_figures(recording, Path(folder), mine)
        other.join()
        sys.exit(other.exitcode)


if __name__ == "__main__":
    _draw_on_request()

"""Live view of a run, in a separate process that cannot disturb the run.

The other process draws and serves. The control loop makes one call that copies the newest numbers
into a socket to that process without waiting: a tick is dropped if the socket is full, so a slow,
stopped or ended viewer costs the loop microseconds. As the viewer is another process, it does not
compete for the interpreter lock.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import pickle
import select
import socket
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from osc_contact.errors import InvalidInputError, ViewerError

LOG = logging.getLogger("osc_contact.viewer")
CHANNELS: dict[str, tuple[int | str, ...]] = {
    "t": (),
    "q": ("joints",),
    "pose": (7,),
    "face_pose": ("contacts", 7),
    "N": (6, "forces"),
    "contact_point": ("contacts", 3),
    "contact_direction": ("contacts", 3),
    "closed": ("contacts",),
    "alpha_cmd": ("forces",),
    "alpha_meas": ("forces",),
    "alpha_true": ("forces",),
    "power_total": (),
    "power_projected": (),
}
"""Channels from which a scene is drawn, with their shapes at one tick; only these are sent."""
START_S = 30.0  #: time to wait for the viewer's process to start (s)
STALLED_S = 1.0  #: time without a tick taken after which a warning is logged (s)
RETRY_S = 0.25  #: interval between attempts to send a tick from then on (s)
SOCKET_BYTES = 1 << 15  #: buffer of the socket (bytes)


class Viewer:
    """Live page at `url`, served on 127.0.0.1 only, by a process that ends with this one.

    Args:
        about: scene that is handed to the process by pickle.
        rate: largest number of pictures per second, 1 … 60.

    Attributes:
        url: address of the page; any number of browsers may open it.
        error: reason why the view has ended, or None; the run continues without it.
        stalled: True if its process has taken no tick for a second, as on a loaded machine; ticks
            are dropped until it does.

    Raises:
        ViewerError: the process does not start.

    Example:
        >>> viewer = osc.open_viewer(osc.load_scenario("two_contact_rod"))
        >>> print(viewer.url.startswith("http://127.0.0.1"))
        True
        >>> viewer.close()
    """

    def __init__(self, about: object, rate: float = 30.0) -> None:
        """Start the process that serves the page, and send it the scene.

        Args:
            about: description of the scene, which is pickled.
            rate: pictures per second, 1 to 60.

        Raises:
            InvalidInputError: the rate is not 1 to 60 pictures per second.
            ViewerError: the process does not start.
        """
        if not 1.0 <= rate <= 60.0:
            raise InvalidInputError(f"rate = {rate}; give 1 to 60 pictures per second")
        self.error: ViewerError | None = None
        self.browsers = 0
        self._end_reason = ""  #: why no more ticks are sent; empty while they are
        self._period = 1.0 / rate  #: time between pictures (s)
        self._next_send = 0.0  #: clock before which no tick is sent (s)
        #: clock since which the process has accepted no tick (s); inf: it accepts them
        self._stalled_since = float("inf")
        self.stalled = False
        # the scene is sent through the process's standard input, ticks later through the link
        #: socket to the process
        self._link, far_end = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with tempfile.TemporaryFile() as complaints:
            with far_end:  # closed here, so that the end of the process closes the link
                self._process = _start_viewer(far_end, complaints)  #: process that serves the page
            try:
                with self._process.stdin as scene:  # type: ignore[union-attr]
                    pickle.dump(about, scene)
                self.url = self._await_address()
            except (OSError, ValueError, KeyError) as error:
                self.close()
                complaints.seek(0)
                lines = complaints.read().decode(errors="replace").strip().splitlines()
                raise ViewerError(
                    f"the live view does not start: {lines[-1] if lines else error}"
                ) from error
        self._link.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SOCKET_BYTES)
        self._link.setblocking(False)

    def _await_address(self) -> str:
        """Address of the page, which the other process sends when it has started.

        Raises:
            OSError: no answer within START_S.
        """
        ready, _, _ = select.select([self._link], [], [], START_S)
        if not ready:
            raise OSError(f"no answer within {START_S:g} s")
        return json.loads(self._link.recv(4096))["url"]

    def show(self, tick: Mapping[str, Any]) -> None:
        """Send the channels of one control tick to the page, without waiting; never raises.

        At most `rate` ticks per second are sent; other calls return immediately.
        """
        time_s = monotonic()
        if time_s < self._next_send or self.error is not None:
            return
        self._next_send = time_s + self._period
        try:
            sample = {name: np.array(tick[name], dtype=float) for name in CHANNELS if name in tick}
            self._link.send(pickle.dumps(sample))
            self._note_taken_tick()
        except BlockingIOError:
            self._note_refused_tick(time_s)
        except OSError:
            self._read_news()
            why = f": {self._end_reason}" if self._end_reason else ""
            self._fail(f"its process has ended (exit code {self._process.poll()}){why}")
        except (TypeError, ValueError) as error:
            self._fail(f"a tick does not hold numbers: {error!r}")

    def _note_taken_tick(self) -> None:
        """Note that the viewer's process has received a tick; report the end of a stall."""
        self._stalled_since = float("inf")
        if self.stalled:
            self.stalled = False
            LOG.info("the live view continues")

    def _note_refused_tick(self, time_s: float) -> None:
        """Note that the other process has taken no tick: log that once, and try less often.

        Args:
            time_s: present time by `monotonic` (s).
        """
        self._stalled_since = min(self._stalled_since, time_s)
        if time_s - self._stalled_since <= STALLED_S:
            return
        self._next_send = time_s + RETRY_S
        if not self.stalled:
            self.stalled = True
            LOG.warning(
                "the live view waits: its process has taken nothing for %g s (a loaded machine?); "
                "the run continues, and the view as soon as it can",
                STALLED_S,
            )

    def _fail(self, reason: str) -> None:
        """End the view with an error that is logged; the run continues."""
        self.error = ViewerError(f"the live view has ended: {reason}; the run continues without it")
        LOG.error("%s", self.error)

    def count_browsers(self) -> int:
        """Number of browsers that show the page, as last reported; returns at once."""
        self._read_news()
        return self.browsers

    def _read_news(self) -> None:
        """Read messages of the other process: number of browsers, and the error that ends it."""
        with contextlib.suppress(OSError, ValueError):  # nothing more to read, or half a message
            while news := self._link.recv(4096):
                message = json.loads(news)
                self.browsers = int(message.get("browsers", self.browsers))
                self._end_reason = str(message.get("error", self._end_reason))

    def close(self) -> None:
        """End the process and free its port; may be called again."""
        self._link.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.error = self.error or ViewerError("the live view was closed")

    def __enter__(self) -> Viewer:
        """Return the viewer itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the viewer."""
        self.close()


def _start_viewer(link: socket.socket, complaints: Any) -> subprocess.Popen[bytes]:
    """Start the viewer's process, which does not get the Ctrl-C of this terminal.

    Args:
        link: socket that it inherits.
        complaints: file of its error output.
    """
    paths = [str(Path(__file__).parents[3]), *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(
        [sys.executable, "-m", "osc_contact.lab.visual.server", str(link.fileno())],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=complaints,
        pass_fds=[link.fileno()],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        start_new_session=True,
    )

"""The receiving end of a live view: of all ticks that came, the newest."""

from __future__ import annotations

import json
import socket

import numpy as np
from numpy.typing import NDArray

from osc_contact.visual.parts import Sample

__all__ = ["Ticks"]


class Ticks:
    """A mailbox that holds one tick.

    Attributes:
        newest: the channels of the last tick that came, until somebody takes it.
    """

    def __init__(self, link: socket.socket) -> None:
        self.link = link
        self.link.setblocking(False)
        self.shapes: dict[str, tuple[int, ...]] = {}
        self.newest: Sample | None = None

    def drain(self) -> bool:
        """Take everything in; False once the other end is closed."""
        numbers = None
        try:
            while message := self.link.recv(1 << 20):
                if not self.shapes:
                    self.shapes = {k: tuple(v) for k, v in json.loads(message).items()}
                else:
                    numbers = message
        except BlockingIOError:
            if numbers is not None:
                self.newest = self._sample(np.frombuffer(numbers))
            return True
        except OSError:
            return False
        return False

    def _sample(self, numbers: NDArray[np.float64]) -> Sample:
        sample, start = {}, 0
        for name, shape in self.shapes.items():
            size = int(np.prod(shape))
            sample[name] = numbers[start : start + size].reshape(shape)
            start += size
        return sample

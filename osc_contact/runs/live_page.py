"""The process behind a live view: ``python -m osc_contact.runs.live_page DESCRIPTOR``."""

import pickle
import socket
import sys
from functools import partial

from osc_contact.runs.viewing import best_frame
from osc_contact.visual.server import serve


def main() -> None:
    """Serve the scene that stands on the standard input, until the inherited socket closes."""
    link = socket.socket(fileno=int(sys.argv[1]))
    content = pickle.load(sys.stdin.buffer)
    serve(link, content, partial(best_frame, size=content.size))


if __name__ == "__main__":
    main()

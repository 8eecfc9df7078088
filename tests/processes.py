"""Processes that tests start: waiting for what they do, and whether they have ended."""

import time
from pathlib import Path


def wait_until(there, seconds=300.0, process=None):
    """Wait for something and return it; a process that is to do it must not end before."""
    deadline = time.monotonic() + seconds
    while not (found := there()):
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return found


def alive(number):
    try:
        return "\nState:\tZ" not in Path(f"/proc/{number}/status").read_text()
    except FileNotFoundError:
        return False

"""Processes that tests start: what they print, waiting for what they do, whether they ended."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]  #: that end programs
COMMAND = [sys.executable, "-c", "from osc_contact.lab.cli.app import app; app()"]


def completed(*words, code=0, **how):
    """A command that has to end with this code (None: with any one), and what it printed."""
    how = {"capture_output": True, "text": True, "timeout": 500} | how
    done = subprocess.run(list(map(str, words)), **how)
    assert code in (None, done.returncode), (done.returncode, done.stdout, done.stderr)
    return done


def python(*words, code=0, cwd=None, timeout=500, **environment):
    """A new Python with these variables, which imports what the tests can import.

    Args:
        words: after the interpreter. code: that it has to end with. timeout: s.
    """
    path = os.pathsep.join((os.path.dirname(__file__), *sys.path))
    env = {**os.environ, "PYTHONPATH": path, **environment}
    return completed(sys.executable, *words, code=code, cwd=cwd, env=env, timeout=timeout)


def started(command, **how):
    """A process whose outputs are read when it has ended."""
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **how
    )


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


def sockets(pid):
    """(ip, port) of a process's network sockets: all that are open, those that listen."""
    opened = psutil.Process(pid).net_connections("all")
    opened = [one for one in opened if one.family != socket.AF_UNIX]
    listening = [tuple(one.laddr) for one in opened if one.status == psutil.CONN_LISTEN]
    return ([one.laddr[0] for one in opened], listening)

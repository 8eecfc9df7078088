"""Processes that tests start: their outputs, waits for their effects, and their ends."""

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
    """Run a command, which has to end with an exit code; return the completed process.

    Args:
        *words: words of the command.
        code: exit code; None: any.
        **how: arguments of `subprocess.run`.
    """
    how = {"capture_output": True, "text": True, "timeout": 500} | how
    done = subprocess.run(list(map(str, words)), **how)
    assert code in (None, done.returncode), (done.returncode, done.stdout, done.stderr)
    return done


def python(*words, code=0, cwd=None, timeout=500, **environment):
    """Run Python in a new process that can import the modules of the tests.

    Args:
        *words: arguments of the interpreter.
        code: exit code; None: any.
        cwd: working directory.
        timeout: time limit (s).
        **environment: environment variables.
    """
    path = os.pathsep.join((os.path.dirname(__file__), *sys.path))
    env = {**os.environ, "PYTHONPATH": path, **environment}
    return completed(sys.executable, *words, code=code, cwd=cwd, env=env, timeout=timeout)


def started(command, **how):
    """Start a process whose outputs are read after its end; `how` has arguments of `Popen`."""
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **how
    )


def wait_until(there, seconds=300.0, process=None):
    """Wait until a function returns a true value; return this value.

    Args:
        there: function without arguments.
        seconds: time limit (s).
        process: process that must not end before, or None.
    """
    deadline = time.monotonic() + seconds
    while not (found := there()):
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return found


def alive(number):
    """True if the process with a number exists and is not a zombie."""
    try:
        return "\nState:\tZ" not in Path(f"/proc/{number}/status").read_text()
    except FileNotFoundError:
        return False


def sockets(pid):
    """Addresses of a process's open network sockets; (address, port) of those that listen."""
    opened = psutil.Process(pid).net_connections("all")
    opened = [one for one in opened if one.family != socket.AF_UNIX]
    listening = [tuple(one.laddr) for one in opened if one.status == psutil.CONN_LISTEN]
    return ([one.laddr[0] for one in opened], listening)

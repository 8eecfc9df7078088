"""The command line inside the process of the tests."""

import json
import shlex
from pathlib import Path
from tempfile import TemporaryDirectory

from typer.testing import CliRunner

from osc_contact.lab.cli.app import app


def call(line, *words):
    """Invoke a line, as typed in a shell, and words beside it; only an exit code may end it."""
    result = CliRunner().invoke(app, [*shlex.split(line), *map(str, words)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def done(line, *words):
    """A command that has to end well."""
    result = call(line, *words)
    assert result.exit_code == 0, result.output
    return result


def answered(line, *words):
    """Run a command, and return its result and the content that it writes with --json."""
    with TemporaryDirectory() as folder:
        file = Path(folder, "found.json")
        return (done(line, *words, "--json", file), read_json(file))


def read_json(file):
    return json.loads(file.read_text())


def refused(line, *words):
    """The message, on one line, of a command that must end with exit code 2."""
    result = call(line, *words)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    assert not result.stdout, "complaints belong on stderr"
    return " ".join(result.stderr.split())

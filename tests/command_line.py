"""The command line inside the process of the tests."""

import shlex

from typer.testing import CliRunner

from osc_contact.cli import app


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


def refused(line, *words):
    """The message, on one line, of a command that must end with exit code 2."""
    result = call(line, *words)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    assert not result.stdout, "complaints belong on stderr"
    return " ".join(result.stderr.split())

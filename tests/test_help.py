"""`help` of public classes: signatures as they are written, and an example that runs."""

from __future__ import annotations

import doctest
import inspect
import math
import pydoc
from itertools import takewhile
from typing import Annotated

import numpy as np
import pinocchio as pin
from samples import parametrize

import osc_contact as osc
from osc_contact.settings.quantities import Frequency, OrderedSpec, Positive

WIDTH = 100  #: columns of a screen
SIGNATURE = 10 * WIDTH  #: characters
SCREEN = 60  #: rows, of the signature, the description and the example

#: All classes; that of `make_vector_env` has another name.
NAMES = [name for name in osc.__all__ if name[0].isupper()] + ["make_vector_env"]


def shown(name):
    """The lines that `help` prints of a class."""
    return pydoc.plain(pydoc.render_doc(getattr(osc, name), "%s")).splitlines()


@parametrize("name", NAMES)
def test_help_shows_signatures_as_they_are_written(name):
    """Not what annotations are made of: a tick of a batch took 3,272 characters."""
    for line in shown(name):
        assert len(line) <= SIGNATURE, line


@parametrize("name", NAMES)
def test_a_screen_shows_the_description_with_an_example(name):
    lines = shown(name)
    ends = ("Method resolution order", "Methods defined here", " |  -----")
    head = list(takewhile(lambda line: not any(end in line for end in ends), lines))
    assert sum(max(1, math.ceil(len(line) / WIDTH)) for line in head) <= SCREEN
    assert any(line.lstrip(" |").startswith(">>> ") for line in head)


@parametrize("name", NAMES)
def test_the_example_runs_and_prints_what_is_shown(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"np": np, "osc": osc, "pin": pin}
    example = doctest.DocTestParser().get_doctest(
        getattr(osc, name).__doc__, names, name, None, None
    )
    printed = []
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    result = runner.run(example, out=printed.append)
    assert result.attempted > 0 and result.failed == 0, "".join(printed)


def test_a_group_of_settings_shows_its_keys_before_and_after_it_is_built():
    """Pydantic builds a group when it is first used, and replaces the signature then."""

    class Own(OrderedSpec):
        rate: Annotated[Positive[Frequency], "Hz"] = 5.0
        gains: osc.Gains = osc.Gains()

    written = "(rate: Positive[Frequency] = 5.0, gains: osc.Gains = Gains())"
    assert str(inspect.signature(Own)) == written
    assert Own("3 Hz").rate == 3.0
    assert str(inspect.signature(Own)) == written

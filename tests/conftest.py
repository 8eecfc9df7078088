"""For all tests: less for the garbage collector to look at, and runs that draw no figures."""

import gc

from pytest import fixture


def pytest_collection_finish():
    gc.collect()
    gc.freeze()  # what was made until now stays


@fixture
def no_figures(monkeypatch):
    """`osc-contact run` without its figures, half of the time: tests/test_cli.py has them drawn."""
    monkeypatch.setattr("osc_contact.visual.plots.save", lambda *_: ())

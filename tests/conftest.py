"""For all tests: less for the garbage collector to look at, and runs that draw no figures."""

import gc
import signal
from unittest.mock import patch

from processes import SIGNALS
from pytest import fixture


def pytest_collection_finish():
    gc.collect()
    gc.freeze()  # what was made until now stays


@fixture
def no_figures(monkeypatch):
    """`osc-contact run` without its figures, half of the time: tests/test_cli.py has them drawn."""
    monkeypatch.setattr("osc_contact.lab.cli.app.available_cores", lambda: 1)  # in this process
    monkeypatch.setattr("osc_contact.lab.visual.plots.save", lambda *_: ())


@fixture
def own_plants():
    """Plants that a test registers are taken out again."""
    from osc_contact.lab.rig.rig import PLANT_TYPES, PLANTS

    with patch.dict(PLANTS), patch.dict(PLANT_TYPES):
        yield


@fixture
def usual_handlers():
    """Signals count, though a shell that runs the tests in the background ignores some."""
    before = list(map(signal.getsignal, SIGNALS))
    for number in SIGNALS:
        usual = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
        signal.signal(number, usual)
    yield
    list(map(signal.signal, SIGNALS, before))

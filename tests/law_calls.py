"""Parts of the law as plain Python: the one place where tests call them.

`from law_calls import reading` is `osc_contact.law.reading` with every function uncompiled, and so
is whatever it calls. Tests pass records made by hand, so that each part is judged alone.
"""

from functools import cache, partial
from importlib import import_module

import numpy as np

from osc_contact.law.jit import as_python
from osc_contact.law.records import Rows, new_model, views


def unwritten(*shape):
    """A local array in which NaN stands where nothing was written."""
    return np.full(shape, np.nan)


plain = cache(partial(as_python, local=unwritten))


def records(arms=0, joints=0, contacts=0, columns=0, **settings):
    """The records of a tick, as the law has them, with these settings."""
    t = views(Rows(new_model(arms, joints, joints, contacts, contacts, columns)))
    write(t.work, mobility=7.0)
    return write(t.model, **settings) and t


def write(record, **values):
    """Fill fields of a record, arrays from their beginning on."""
    for name, value in values.items():
        if np.ndim(value):
            getattr(record, name)[tuple(map(slice, np.shape(value)))] = value
        else:
            setattr(record, name, value)
    return True


class Parts:
    """The functions of a module of the law."""

    def __init__(self, name):
        self._module = import_module(f"osc_contact.law.{name}")

    def __getattr__(self, name):
        value = getattr(self._module, name)
        return plain(value) if callable(value) else value

    def altered(self, name, **instead):
        """A function in which other global names stand for something else."""
        return as_python(getattr(self._module, name), local=unwritten, **instead)


@cache
def __getattr__(name):
    if name.startswith("__"):
        raise AttributeError(name)
    return Parts(name)

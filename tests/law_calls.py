"""Parts of the law as plain Python, for tests of single parts with records made by hand.

`from law_calls import reading` is `osc_contact.law.reading` with all of its functions, and those
that they call, uncompiled.
"""

from functools import cache, partial
from importlib import import_module

import numpy as np

from osc_contact.law.jit import as_python
from osc_contact.law.records import Rows, new_model, views


def unwritten(*shape):
    """Local array of a shape, filled with NaN, so that elements that were not written are found."""
    return np.full(shape, np.nan)


plain = cache(partial(as_python, local=unwritten))


def records(arms=0, joints=0, contacts=0, columns=0, **settings):
    """Records of a tick as the law has them.

    Args:
        arms, joints, contacts, columns: sizes of MODEL; each contact has one shape.
        **settings: values of fields of MODEL, see `write`.
    """
    t = views(Rows(new_model(arms, joints, joints, contacts, contacts, columns)))
    write(t.work, mobility=7.0)
    return write(t.model, **settings) and t


def write(record, **values):
    """Fill fields of a record; arrays are filled from their beginning. Returns True."""
    for name, value in values.items():
        if np.ndim(value):
            getattr(record, name)[tuple(map(slice, np.shape(value)))] = value
        else:
            setattr(record, name, value)
    return True


class Parts:
    """Functions of a module of the law as plain Python."""

    def __init__(self, name):
        """Import the module `name` of osc_contact.law."""
        self._module = import_module(f"osc_contact.law.{name}")

    def __getattr__(self, name):
        """Function of the module, uncompiled, or another value."""
        value = getattr(self._module, name)
        return plain(value) if callable(value) else value

    def altered(self, name, **instead):
        """Function of the module, uncompiled, with other values of the global names `instead`."""
        return as_python(getattr(self._module, name), local=unwritten, **instead)


@cache
def __getattr__(name):
    """Module of the law as `Parts`."""
    if name.startswith("__"):
        raise AttributeError(name)
    return Parts(name)

"""Parts of the law as plain Python: the one place where tests call them.

`from law_calls import force` is `osc_contact.law.force` with every function uncompiled, whatever it
calls included. Tests hand over records made by hand, so that each part is judged alone.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module

from osc_contact.law.jit import as_python

plain = cache(as_python)


class Parts:
    """The functions of a module of the law."""

    def __init__(self, name):
        self._module = import_module(f"osc_contact.law.{name}")

    def __getattr__(self, name):
        value = getattr(self._module, name)
        return plain(value) if callable(value) else value

    def altered(self, name, **instead):
        """A function in which other global names stand for something else."""
        return as_python(getattr(self._module, name), **instead)


@cache
def __getattr__(name):
    if name.startswith("__"):
        raise AttributeError(name)
    return Parts(name)

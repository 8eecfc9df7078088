"""Parts of the law as plain Python: the one place where tests call them.

`from law_calls import reading` is `osc_contact.law.reading` with every function uncompiled, and so
is whatever it calls. Tests pass records made by hand, so that each part is judged alone.
"""

from functools import cache
from importlib import import_module

from osc_contact.law.jit import as_python
from osc_contact.law.records import Tick

plain = cache(as_python)


class Nested:
    """A record and its tables, as `osc_contact.law.nested.View` has them, of a test's own."""

    def __init__(self, head, tables):
        self.__dict__.update(tables, head=head)

    def __getattr__(self, name):
        return getattr(self.__dict__["head"], name)

    def __setattr__(self, name, value):
        setattr(self.__dict__["head"], name, value)


def tick_of(model=None, memory=None, work=None, input=None, **tables):
    """What the parts of a tick take: heads, and tables as work_joints=…; the heads are changed."""
    heads = {"model": model, "memory": memory, "work": work, "input": input}
    own = {name: {} for name in heads}
    for name, table in tables.items():
        record, _, rest = name.partition("_")
        own[record][rest] = table
    return Tick(**{name: Nested(head, own[name]) for name, head in heads.items()})


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

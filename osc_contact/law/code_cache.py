"""numba's cache of machine code, checked: fresh with respect to all of the law, and undamaged.

numba compares the date of the one file that an entry is defined in, and unpickles whatever it
finds. Here an edit of any source of the law is an edit of every entry, each piece of code is kept
with its key and a checksum, and what cannot be read is compiled anew.

It rests on numba's own classes: where they have other names, `jit` caches as numba does.
"""

from __future__ import annotations

import logging
import pickle
import zlib
from contextlib import suppress
from typing import Any

import llvmlite
import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile

from osc_contact.law.sources import law_hash

_log = logging.getLogger(__name__)

for _class, _names in (
    (FunctionCache, ("load_overload", "save_overload", "flush")),
    (IndexDataCacheFile, ("load", "save", "_dump")),
    (CompileResultCacheImpl, ("reduce", "rebuild")),
):
    for _name in _names:
        getattr(_class, _name)  # another numba may have others: an AttributeError, see `jit`


class _CheckedFile(IndexDataCacheFile):
    """numba's index and its data, which hold their own key and a checksum."""

    def save(self, key: Any, data: Any) -> None:
        content = self._dump((key, data))
        super().save(key, (zlib.crc32(content), content))

    def load(self, key: Any) -> Any:
        found = super().load(key)
        if found is None:
            return None
        checksum, content = found
        if zlib.crc32(content) != checksum:
            raise ValueError("its checksum does not fit")
        of, data = pickle.loads(content)
        if of != key:
            raise ValueError("it is the code of another function")
        return data


class _WithObject(CompileResultCacheImpl):
    """What Python calls, kept with the object that it calls."""

    machine_code: Any = None

    def reduce(self, data: Any) -> Any:
        kinds = data.signature.args
        code = self.machine_code and self.machine_code.object(kinds)
        return kinds, code, super().reduce(data)

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        kinds, code, data = payload
        if code is not None:
            self.machine_code.take(kinds, code)
        return super().rebuild(target_context, data)


class CodeCache(FunctionCache):
    """The cache of one entry.

    Damaged files and a folder that cannot be written cost a compilation and a line of log; they
    are no error.
    """

    _impl_class = _WithObject

    def __init__(self, function: Any, machine_code: Any = None) -> None:
        """Of a function; `machine_code`: `units.MachineCode` of it, or None: public numba."""
        super().__init__(function)
        self._impl.machine_code = machine_code
        date = self._impl.locator.get_source_stamp()
        self._cache_file = _CheckedFile(
            self.cache_path,
            self._impl.filename_base,
            (date, law_hash(), numba.__version__, llvmlite.__version__),
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code of a signature; None: there is none that can be used."""
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # whatever damaged pickles end in
            self._report("cannot be read, so it is compiled anew", error)
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code of a signature."""
        try:
            super().save_overload(sig, data)
        except Exception as error:
            self._report("cannot be kept, so every process compiles it", error)

    def _report(self, what: str, error: Exception) -> None:
        name = f"the compiled {self._impl.filename_base} in {self.cache_path}"
        _log.warning("%s %s (%s: %s)", name, what, type(error).__name__, error)

"""What rests on numba's own classes: a faster first compilation.

numba optimises every function and turns it into machine code, whether Python can call it or not.
The parts of the law are called by its entry alone, which is optimised as a whole with all of them
in it.

These classes may change: where they do, `jit` compiles with public numba instead, to the same code.
OSC_CONTACT_ACCELERATOR=0 leaves all of it out.
"""

from __future__ import annotations

import ctypes
import sys
from typing import Any

from numba.core import ir
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.typed_passes import NopythonTypeInference
from numba.core.untyped_passes import InlineClosureLikes, IRProcessing

for _name in (
    "_finalize_dynamic_globals",
    "_get_module_for_linking",
    "_optimize_functions",
    "_ensure_finalized",
    "finalize",
):
    getattr(JITCodeLibrary, _name)  # another numba may have others: an AttributeError, see `jit`


class _NoSymbols:
    """Stands for a code generator where there is no machine code whose symbols could be set."""

    def set_env(self, name: str, env: Any) -> None:
        pass


class _PartLibrary(JITCodeLibrary):
    """Code that is linked into the entry, once, and left as it is until then."""

    codegen = _NoSymbols()

    def finalize(self) -> None:
        self._finalize_dynamic_globals()
        for function in self._final_module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        self._finalized = True

    def _get_module_for_linking(self) -> Any:
        """With all that it calls: for callers that numba compiles as usual."""
        if self._shared_module is None:
            self._shared_module = self._final_module.clone()
            _link(self, self._shared_module)
        return self._shared_module

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0


class _EntryLibrary(JITCodeLibrary):
    """Code of an entry and of all parts that it calls, and that these call.

    numba links what a function calls into each of them, so that most parts would be linked,
    and copied, a hundred times.
    """

    def finalize(self) -> None:
        _link(self, self._final_module)
        self._linking_libraries = []
        super().finalize()


def _link(library: Any, module: Any) -> None:
    """Link into a module what its library calls, directly or not, each library once."""
    called = list(dict.fromkeys(library._linking_libraries))
    for one in called:  # more of them as it goes on
        library._reload_init.update(one._reload_init)
        if isinstance(one, _PartLibrary):
            called += [x for x in dict.fromkeys(one._linking_libraries) if x not in called]
            module.link_in(one._final_module, preserve=True)
        else:
            module.link_in(one._get_module_for_linking(), preserve=True)


@register_pass(mutates_CFG=False, analysis_only=False)
class _AsPart(FunctionPass):
    """Chooses the library that the code goes to."""

    _name = "as_part"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return True


@register_pass(mutates_CFG=False, analysis_only=False)
class _AsEntry(FunctionPass):
    """The same for what Python calls; cached on disk."""

    _name = "as_entry"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        state.library = _EntryLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return True


@register_pass(mutates_CFG=False, analysis_only=False)
class _PlainNumbers(FunctionPass):
    """Takes a constant for any number of its type.

    numba gives constants types of their own, and compiles what they are handed to for each of them;
    also for the 0 that a variable begins with, before it sees what else the variable may be.
    """

    _name = "plain_numbers"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        for block in state.func_ir.blocks.values():
            for assignment in block.find_insts(ir.Assign):
                if isinstance(assignment.value, ir.Const):
                    assignment.value.use_literal_type = False
        return True


class _Flags(Flags):
    """Options of a compilation that tell their values at once.

    numba asks for them at every pass, and at each call of a function of its own to compare them,
    and looks each of thirty up: a fifth of the whole compilation.
    """

    __slots__ = ()

    def values(self) -> dict[str, Any]:
        return {**_DEFAULTS, **self._values}

    def __eq__(self, other: object) -> bool:
        if type(other) is _Flags:
            return bool(self._values == other._values)
        return bool(super().__eq__(other))

    def __hash__(self) -> int:
        return _HASH


_DEFAULTS = Flags().values()
_HASH = hash(Flags())  #: that of all flags: it is made of their names
_Flags().values()  # another numba may keep them elsewhere: an AttributeError, see `jit`


class _Arguments(tuple[Any, ...]):
    """Types of a function's arguments, without the many words that numba puts into its events."""

    def __str__(self) -> str:
        return f"{len(self)} arguments"


class PartCompiler(CompilerBase):
    """numba's compiler without the machine code."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.state.flags = _Flags(self.state.flags)
        self.state.args = _Arguments(self.state.args)

    def define_pipelines(self) -> Any:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        # the law defines no functions within functions
        passes.passes = [one for one in passes.passes if one[0] is not InlineClosureLikes]
        passes.add_pass_after(_AsPart, NopythonTypeInference)
        passes.add_pass_after(_PlainNumbers, IRProcessing)
        passes.finalize()
        return [passes]


class EntryCompiler(CompilerBase):
    """numba's compiler, with everything that is called linked in at once."""

    def define_pipelines(self) -> Any:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_AsEntry, NopythonTypeInference)
        passes.finalize()
        return [passes]


def part_options() -> dict[str, Any]:
    """Options of `numba.njit` for functions that only compiled functions call.

    `_nrt`: the law makes no arrays, so nothing needs to be counted.
    """
    return {
        "no_cpython_wrapper": True,
        "no_cfunc_wrapper": True,
        "pipeline_class": PartCompiler,
        "_nrt": False,
    }


def entry_options() -> dict[str, Any]:
    """The same for functions that Python calls."""
    return {"no_cfunc_wrapper": True, "pipeline_class": EntryCompiler, "_nrt": False}


def direct(entry: Any) -> Any:
    """The entry without numba's look at the types of its arguments, see `jit.direct`.

    The entry itself where it was not called before, or with other types, too.
    """
    if len(entry.overloads) != 1:
        return entry
    (compiled,) = entry.overloads.values()
    return getattr(compiled, "entry_point", entry)


def forget_code(entry: Any) -> None:
    """Give back the intermediate code that numba keeps for callers that are linked with an entry.

    There are none. Of the tick it takes 19 MB.
    """
    for compiled in entry.overloads.values():
        library: Any = getattr(compiled, "library", None)
        kept = getattr(library, "_shared_module", None)
        if kept is not None:
            library._shared_module = None
            kept.close()
    if sys.platform == "linux":  # glibc keeps what is freed, unless it is asked to
        getattr(ctypes.CDLL(None), "malloc_trim", int)(0)

"""Parts of the law compiled by themselves and called by symbol; machine code of all of them.

numba links what a function calls into each of its callers, so that most parts would be optimised a
hundred times. Here each part is translated once, callers name it by its symbol, and LLVM links,
optimises and emits all parts of an entry at once, for any processor of the platform.

This is all that rests on undocumented numba (`compile_extra` and its flags, function descriptors,
the calling convention, modules of libraries). Where it is missing, `jit` compiles with public numba
instead, to the same results.
"""

from __future__ import annotations

import inspect
import platform
from collections.abc import Callable
from typing import Any

from llvmlite import binding as llvm
from numba import types
from numba.core import cgutils
from numba.core.codegen import CPUCodeLibrary
from numba.core.compiler import Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.extending import intrinsic

for _class, _names in (
    (Flags, ("no_compile", "no_cpython_wrapper", "no_cfunc_wrapper", "error_model", "nrt")),
    (CPUCodeLibrary, ("_get_module_for_linking",)),
):
    for _name in _names:
        getattr(_class, _name)  # another numba may have others: an AttributeError, see `jit`

#: What every processor of the platform has; elsewhere code is made for the one at hand.
BASELINE = {"x86_64": "x86-64", "AMD64": "x86-64", "aarch64": "generic", "arm64": "generic"}
_units: list[Unit] = []
_made: dict[str, Any] = {}  #: translated parts by their symbols
watchers: list[Callable[[float], None]] = []  #: take the share of the parts that is translated


class Unit:
    """A part, translated once for each list of types of its arguments.

    Attributes:
        py_func: its source. inlined: whether its callers take it in.
    """

    def __init__(self, function: Any, inlined: bool) -> None:
        self.py_func = function
        self.inlined = inlined
        self.known: dict[Any, Any] = {}
        _units.append(self)

    @global_compiler_lock
    def translated(self, kinds: tuple[Any, ...]) -> Any:
        """Its signature, symbol and code without what it calls."""
        if kinds not in self.known:
            self.known[kinds] = made = self._translate(kinds)
            _made[made.fndesc.llvm_func_name] = made
            for watch in watchers:
                watch(sum(bool(unit.known) for unit in _units) / len(_units))
        return self.known[kinds]

    def _translate(self, kinds: tuple[Any, ...]) -> Any:
        flags: Any = Flags()
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        flags.error_model = "numpy"
        flags.nrt = False  # the law makes no arrays, so nothing needs to be counted
        flags.forceinline = self.inlined
        context = cpu_target.target_context
        return compile_extra(
            cpu_target.typing_context, context, self.py_func, kinds, None, flags, {}
        )


def called(unit: Unit) -> Any:
    """A function of compiled code that calls a unit by its symbol."""

    def typed(typing: Any, *given: Any) -> Any:
        kinds = tuple(types.unliteral(one) for one in given)
        made = unit.translated(kinds)
        returned = made.signature.return_type

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            symbol = made.fndesc.llvm_func_name
            convention = context.call_conv
            kind = convention.get_function_type(returned, kinds)
            function = cgutils.get_or_insert_function(builder.module, kind, symbol)
            cast = [
                context.cast(builder, *one)
                for one in zip(values, signature.args, kinds, strict=True)
            ]
            return convention.call_function(builder, function, returned, kinds, cast)[1]

        return returned(*kinds), generate

    parameter = inspect.Parameter
    names = ("typing", *inspect.signature(unit.py_func).parameters)
    typed.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [parameter(one, parameter.POSITIONAL_OR_KEYWORD) for one in names]
    )
    typed.__name__ = unit.py_func.__name__
    made: Any = intrinsic(typed)
    made.py_func = unit.py_func
    made.unit = unit
    return made


# --- Machine code ---------------------------------------------------------------------------------


def baseline() -> str:
    """The processor that every machine of this platform can stand in for."""
    return BASELINE.get(platform.machine()) or str(llvm.get_host_cpu_name())


def link(roots: dict[str, Any]) -> Any:
    """A module of some units and all that they call, which offers nothing else.

    Args:
        roots: what `Unit.translated` returned, by the symbols that the module shall offer.
    """
    module = llvm.parse_assembly("")
    left = list(roots.values())
    linked: set[str] = set()
    while left:
        made = left.pop()
        if made.fndesc.llvm_func_name in linked:
            continue
        linked.add(made.fndesc.llvm_func_name)
        own = made.library._final_module
        module.link_in(own, preserve=True)
        for library in dict.fromkeys(made.library._linking_libraries):
            module.link_in(library._get_module_for_linking(), preserve=True)
        left += [_made[one.name] for one in own.functions if one.name in _made]
    for one in (*module.functions, *module.global_variables):
        if not one.is_declaration:
            one.linkage = "internal"
    for symbol, made in roots.items():
        function = module.get_function(made.fndesc.llvm_func_name)
        function.linkage = "external"
        function.name = symbol
    return module


@global_compiler_lock
def emit(roots: dict[str, Any], triple: str = "") -> bytes:
    """An object file of some units and all that they call, for every processor of a platform.

    Args:
        roots: see `link`. triple: LLVM's name of a 64-bit platform; "": of this one.
    """
    cpu = baseline()
    if triple:
        cpu = BASELINE[triple.partition("-")[0]]
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
    triple = triple or llvm.get_process_triple()
    target = llvm.Target.from_triple(triple).create_target_machine(
        cpu=cpu, opt=3, reloc="pic", codemodel="default"
    )
    module = link(roots)
    module.triple = triple
    module.data_layout = str(target.target_data)
    module.verify()
    tuning = llvm.create_pipeline_tuning_options(3)
    tuning.loop_vectorization = tuning.slp_vectorization = True
    builder = llvm.create_pass_builder(target, tuning)
    builder.getModulePassManager().run(module, builder)
    return bytes(target.emit_object(module))

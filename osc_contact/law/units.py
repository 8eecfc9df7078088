"""Parts of the law compiled by themselves and called by symbol; machine code of all of them.

numba links what a function calls into each of its callers, so that most parts would be optimised a
hundred times. Here each part is translated once for each list of argument types, callers name it by
its symbol, and LLVM links, optimises and emits all parts of an entry at once, for any processor of
the platform. Translated parts are kept (`store`) under the hash of all they are made of
(`ingredients`), so that an edit of the law translates again only what it changed.

A part is kept twice: simplified, for 64-bit platforms, and as numba wrote it, for WebAssembly. LLVM
simplifies with the size of this machine's pointers; where pointers have 32 bits the object made of
that is wrong without an error, so `link` refuses it.

This, with `nested_tables`, is all that rests on undocumented numba (`compile_extra` and its flags,
passes, function descriptors, the calling convention, libraries and their modules). Where it is
missing, `jit` compiles with public numba instead, to the same results.
"""

from __future__ import annotations

import inspect
import os
import pickle
import platform
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, Any, NamedTuple
from zlib import compress, decompress

import llvmlite
import numba
import numpy as np
from llvmlite import binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils, typed_passes, untyped_passes
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import CompilerBase, Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager
from numba.core.errors import NumbaError
from numba.core.registry import cpu_target
from numba.extending import intrinsic

from osc_contact.errors import OscContactError
from osc_contact.law import library
from osc_contact.law.ingredients import digest
from osc_contact.law.nested_tables import lower_tables as lower_tables  # for `nested_type`
from osc_contact.law.store import Store

if TYPE_CHECKING:
    from osc_contact.law.numba_types import (
        Builder,
        CPUContext,
        Intrinsic,
        Signature,
        Type,
        TypingContext,
        Value,
        Values,
    )

for _class, _names in (
    (Flags, ("no_compile", "no_cpython_wrapper", "no_cfunc_wrapper", "error_model", "nrt")),
    (CPUCodeLibrary, ("_get_module_for_linking", "_optimize_functions", "add_llvm_module")),
    (JITCPUCodegen, ("_library_class",)),
):
    for _name in _names:
        getattr(_class, _name)  # another numba may have others: an AttributeError, see `jit`

#: Processors that code is made for, by the platform: what every processor of it has.
BASELINE = {
    "x86_64": "x86-64",
    "AMD64": "x86-64",
    "aarch64": "generic",
    "arm64": "generic",
    "wasm32": "generic",
}
#: Platforms whose pointers are not those of the machines that numba compiles for.
PLAIN = ("wasm32",)
#: Translated parts that stay in the user's cache, some 20 kB each.
KEPT = 4_000
#: Modules that translate parts and hold none: an edit of these files makes all parts anew.
_MACHINERY = (
    "ingredients",
    "jit",
    "layout_code",
    "nested",
    "nested_tables",
    "nested_type",
    "store",
    "units",
)

_units: dict[str, Unit] = {}
_parts: dict[str, Part] = {}  #: translated parts by their symbols
#: Called when a part is ready: with the share of units that have one, and whether it was kept.
watchers: list[Callable[[float, bool], None]] = []


class Call(NamedTuple):
    """Which part another one calls, and the type of the result that it counts on."""

    unit: str
    kinds: tuple[Type, ...]
    returned: Type


class Part(NamedTuple):
    """A unit translated for one list of argument types.

    Attributes:
        symbol: name of its function. returned: type of the result. code: bitcode of the function
            and of helpers of numba that it calls, simplified. calls: other parts that it calls.
        plain: the same bitcode as numba wrote it, compressed; empty where this process had compiled
            one of the helpers before.
    """

    symbol: str
    returned: Type
    code: bytes
    calls: tuple[Call, ...]
    plain: bytes

    def module(self, plain: bool) -> llvm.ModuleRef:
        """Its code.

        Args:
            plain: as numba wrote it, not simplified.
        """
        return llvm.parse_bitcode(decompress(self.plain) if plain else self.code)


class Unit:
    """A function of the law, translated once for each list of types of its arguments.

    Attributes:
        name: module and name of the function. py_func: its source. inlined: whether its callers
            take it in. known: its parts by the types of the arguments.
    """

    def __init__(self, function: FunctionType, inlined: bool) -> None:
        name = f"{function.__module__}.{function.__qualname__}".removeprefix(f"{__package__}.")
        same = sum(other.partition("~")[0] == name for other in _units)
        self.name = f"{name}~{same}" if same else name
        self.py_func = function
        self.inlined = inlined
        self.known: dict[tuple[Type, ...], Part] = {}
        _units[self.name] = self

    @global_compiler_lock
    def translated(self, kinds: tuple[Type, ...]) -> Part:
        """The part for arguments of these types: the one that was kept, or a new one."""
        if kinds not in self.known:
            symbol = f"{self.name}.{sha256(str(kinds).encode()).hexdigest()[:12]}"
            key = self.key(kinds)
            part = _find(key, symbol)
            kept = part is not None
            if part is None:
                part = self._translate(kinds, symbol)
                if part.plain:
                    _store().keep(key, pickle.dumps(tuple(part)))
            self.known[kinds] = _parts[symbol] = part
            for watch in watchers:
                watch(sum(bool(unit.known) for unit in _units.values()) / len(_units), kept)
        return self.known[kinds]

    def key(self, kinds: tuple[Type, ...]) -> str:
        """Hash of all that the part for these types is made of, but for the parts that it calls."""
        made_of = (_machinery(), self.name, self.inlined, kinds, digest(self.py_func))
        return sha256("\n".join(map(str, made_of)).encode()).hexdigest()

    def _translate(self, kinds: tuple[Type, ...], symbol: str) -> Part:
        flags: Any = Flags()
        flags.no_compile = flags.no_cpython_wrapper = flags.no_cfunc_wrapper = True
        flags.error_model = "numpy"
        flags.nrt = False  # the law makes no arrays, so nothing needs to be counted
        flags.forceinline = self.inlined
        context = cpu_target.target_context
        with _helpers_kept_plain(context.codegen()):
            made = compile_extra(
                cpu_target.typing_context,
                context,
                self.py_func,
                kinds,
                None,
                flags,
                {},
                library=_Library(context.codegen(), symbol),
                pipeline_class=_Pipeline,
            )
        module = llvm.parse_assembly("")
        module.link_in(made.library._final_module, preserve=True)
        for used in dict.fromkeys(made.library._linking_libraries):
            module.link_in(used._get_module_for_linking(), preserve=True)
        module.get_function(made.fndesc.llvm_func_name).name = symbol
        module = _simplified(module, symbol)
        calls = [_call_of(_parts[one.name]) for one in module.functions if one.name in _parts]
        plain = _plain(made.library, made.fndesc.llvm_func_name, symbol)
        return Part(symbol, made.signature.return_type, module.as_bitcode(), tuple(calls), plain)


def all_units() -> list[Unit]:
    """Every function of the law that is translated by itself, in the order of the modules."""
    return [*_units.values()]


def translate_from_the_end(parameter: str, kind: Type) -> None:
    """Translate the units with one parameter of this name, the last one first.

    Units that take no argument of this type are left out.

    Args:
        parameter: its name. kind: type of the argument.
    """
    for unit in reversed(all_units()):
        if [*inspect.signature(unit.py_func).parameters] == [parameter]:
            with suppress(NumbaError):
                unit.translated((kind,))


class _Pipeline(CompilerBase):
    """The passes of numba that the law needs: it has no closures and no array expressions."""

    def define_pipelines(self) -> list[PassManager]:
        """One pipeline; what it cannot translate is an error."""
        passes = PassManager("law")
        for one in (
            untyped_passes.TranslateByteCode,
            untyped_passes.FixupArgs,
            untyped_passes.IRProcessing,
            untyped_passes.RewriteSemanticConstants,
            untyped_passes.DeadBranchPrune,
            untyped_passes.GenericRewrites,
            untyped_passes.ReconstructSSA,
            typed_passes.NopythonTypeInference,
            typed_passes.PreLowerStripPhis,
            typed_passes.IRLegalization,
            typed_passes.AnnotateTypes,
            typed_passes.NativeLowering,
            typed_passes.NoPythonBackend,
        ):
            passes.add_pass(one, one.__name__)
        passes.finalize()
        return [passes]


class _Helper(JITCodeLibrary):
    """Modules of a helper of numba, optimised as numba does it.

    Attributes:
        plain: bitcode of each as numba wrote it.
    """

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.plain: list[bytes] = []

    def add_llvm_module(self, module: llvm.ModuleRef) -> None:
        """Keep the bitcode of a module before it is optimised.

        Args:
            module: of LLVM.
        """
        self.plain.append(module.as_bitcode())
        super().add_llvm_module(module)


class _Library(_Helper):
    """Modules of one part, which are optimised later, with those of the helpers that they call."""

    def _optimize_functions(self, module: llvm.ModuleRef) -> None:
        module.data_layout = self._codegen._data_layout


@contextmanager
def _helpers_kept_plain(codegen: JITCPUCodegen) -> Iterator[None]:
    """Within it helpers that numba compiles are kept as it wrote them, too.

    Args:
        codegen: numba's maker of libraries.
    """
    usual = codegen._library_class
    codegen._library_class = _Helper
    try:
        yield
    finally:
        codegen._library_class = usual


def _plain(library: _Helper, name: str, symbol: str) -> bytes:
    """Bitcode of a part and its helpers as numba wrote them; empty: one was compiled before.

    Args:
        library: of the part. name: of its function there. symbol: its name from now on.
    """
    libraries = [library]
    for one in libraries:  # it grows meanwhile
        if not isinstance(one, _Helper):
            return b""
        libraries += [used for used in one._linking_libraries if used not in libraries]
    linked = llvm.parse_assembly("")
    for code in [code for one in libraries for code in one.plain]:
        module = llvm.parse_bitcode(code)
        module.data_layout = ""
        for one in _defined(module):
            if one.linkage == llvm.Linkage.external and one.name != name:
                one.linkage = "linkonce_odr"
        linked.link_in(module)
    linked.get_function(name).name = symbol
    return compress(_with_own_helpers(linked, symbol).as_bitcode())


def _call_of(part: Part) -> Call:
    """A part as another one calls it."""
    for unit in _units.values():
        for kinds, known in unit.known.items():
            if known is part:
                return Call(unit.name, kinds, part.returned)
    raise KeyError(part.symbol)


def called(unit: Unit) -> Any:
    """A function of compiled code that calls a unit by its symbol.

    A unit that is inlined takes arrays that are fields of records as arrays of any size: one
    translation serves all sizes, and LLVM finds the size again where it inlines it.
    """

    def typed(typing: TypingContext, *given: Type) -> Intrinsic:
        given = tuple(types.unliteral(one) for one in given)
        kinds = tuple(_any_size(one) for one in given) if unit.inlined else given
        part = unit.translated(kinds)

        def generate(
            context: CPUContext, builder: Builder, signature: Signature, values: Values
        ) -> Value:
            convention = context.call_conv
            kind = convention.get_function_type(part.returned, kinds)
            function = cgutils.get_or_insert_function(builder.module, kind, part.symbol)
            cast = [
                value
                if from_kind is not to_kind and isinstance(from_kind, types.NestedArray)
                else context.cast(builder, value, from_kind, to_kind)
                for value, from_kind, to_kind in zip(values, signature.args, kinds, strict=True)
            ]
            return convention.call_function(builder, function, part.returned, kinds, cast)[1]

        return part.returned(*given), generate

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


def _any_size(kind: Type) -> Type:
    """The type of an array whatever its size, if the size is part of its own type."""
    if isinstance(kind, types.NestedArray):
        return types.Array(kind.dtype, kind.ndim, "C")
    return kind


# --- Parts that are kept --------------------------------------------------------------------------


@cache
def _store() -> Store:
    return Store(library.cache_folder() / "parts")


@cache
def _machinery() -> str:
    """Hash of all that parts depend on beside their own ingredients."""
    here = Path(__file__).parent
    options = {key: value for key, value in os.environ.items() if key.startswith("NUMBA_")}
    options.pop("NUMBA_CACHE_DIR", None)
    made_of = (
        *((here / f"{name}.py").read_text() for name in _MACHINERY),
        (numba.__version__, llvmlite.__version__, np.__version__, sys.version),
        sorted(options.items()),
        cpu_target.target_context.codegen().magic_tuple(),
    )
    return sha256("\n".join(map(str, made_of)).encode()).hexdigest()


def _find(key: str, symbol: str) -> Part | None:
    """A part that was kept, if all that it calls still returns what it counts on."""
    content = _store().find(key)
    if content is None:
        return None
    try:
        _, returned, code, calls, plain = pickle.loads(content)
    except KeyError:  # a record that it takes or hands on has another layout now
        return None
    for call in calls:
        unit = _units.get(call.unit)
        try:
            if unit is None or unit.translated(call.kinds).returned != call.returned:
                return None
        except NumbaError:  # it no longer takes such arguments
            return None
    return Part(symbol, returned, code, calls, plain)


# --- Machine code ---------------------------------------------------------------------------------


def target_of(triple: str = "") -> llvm.TargetMachine:
    """LLVM's description of what every processor of a platform has.

    Args:
        triple: LLVM's name of a 64-bit platform; "": of this one, where it is not listed in
            BASELINE of the processor at hand only.

    Raises:
        OscContactError: another platform that is not listed.
    """
    machine = triple.partition("-")[0] if triple else platform.machine()
    cpu = BASELINE.get(machine)
    if triple and cpu is None:
        raise OscContactError(
            f"the law cannot be compiled for {triple!r}: its first word is {machine!r}, and "
            f"known are {', '.join(sorted(BASELINE))}, as in aarch64-linux-gnu"
        )
    if triple:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(triple or llvm.get_process_triple())
    return target.create_target_machine(
        cpu=cpu or llvm.get_host_cpu_name(), opt=3, reloc="pic", codemodel="default"
    )


@cache
def _own_target() -> llvm.TargetMachine:
    return target_of()


def _pass_builder(target: llvm.TargetMachine) -> llvm.PassBuilder:
    """Maker of the passes of LLVM's third level for a target."""
    tuning = llvm.create_pipeline_tuning_options(3)
    tuning.loop_vectorization = tuning.slp_vectorization = True
    return llvm.create_pass_builder(target, tuning)


def _simplified(linked: llvm.ModuleRef, symbol: str) -> llvm.ModuleRef:
    """A part as others take it in: simplified, with the helpers that it calls and no others.

    Args:
        linked: module of the part and of helpers of numba. symbol: name of the part's function.
    """
    builder = _pass_builder(_own_target())
    builder.getFunctionPassManager().run(linked.get_function(symbol), builder)
    return _with_own_helpers(linked, symbol)


def _with_own_helpers(linked: llvm.ModuleRef, symbol: str) -> llvm.ModuleRef:
    """A part with the helpers that it calls and no others, under names of its own.

    Args:
        linked: see `_simplified`. symbol: name of the part's function.
    """
    for one in _defined(linked):
        if one.name != symbol:
            one.linkage = "linkonce_odr"  # then only those that are used come into a module
    module = llvm.parse_assembly("")
    module.link_in(linked)
    helpers = [one for one in _defined(module) if one.name != symbol]
    for number, one in enumerate(helpers):
        one.linkage = "internal"
        one.name = f"{symbol}.{number}"  # numba's own names count what the process compiled
    module.name = symbol
    return module


def _defined(module: llvm.ModuleRef) -> list[llvm.ValueRef]:
    """Functions and variables of a module that are defined in it."""
    return [one for one in (*module.functions, *module.global_variables) if not one.is_declaration]


def _needed(roots: dict[str, Part]) -> list[Part]:
    """Some parts and all that they call, in an order that no process chooses."""
    found: dict[str, Part] = {}
    left = list(roots.values())
    while left:
        part = left.pop()
        if part.symbol not in found:
            found[part.symbol] = part
            left += [_units[call.unit].known[call.kinds] for call in part.calls]
    return [found[symbol] for symbol in sorted(found)]


def link(roots: dict[str, Part], target: llvm.TargetMachine, plain: bool) -> llvm.ModuleRef:
    """A module of some parts and all that they call, which offers nothing else.

    Args:
        roots: parts by the symbols that the module shall offer. target: see `target_of`.
        plain: whether it is made of parts as numba wrote them.

    Raises:
        OscContactError: a part was simplified for pointers of another size than the target's.
    """
    module = llvm.parse_assembly("")
    own = _pointer_bytes(str(target.target_data))
    for part in _needed(roots):
        code = part.module(plain)
        if code.data_layout and _pointer_bytes(code.data_layout) != own:
            raise OscContactError(
                f"{part.symbol} was simplified for pointers of "
                f"{_pointer_bytes(code.data_layout)} bytes, and those of {target.triple} have "
                f"{own}: the object would be wrong without an error; link plain parts"
            )
        module.link_in(code)
    for one in _defined(module):
        one.linkage = "internal"
    for name, part in roots.items():
        function = module.get_function(part.symbol)
        function.linkage = "external"
        function.name = name
    return module


def _pointer_bytes(layout: str) -> int:
    """Size of a pointer in a data layout of LLVM."""
    return int(ir.IntType(8).as_pointer().get_abi_size(llvm.create_target_data(layout)))


@global_compiler_lock
def emit(
    roots: dict[str, Part],
    target: llvm.TargetMachine,
    report: Callable[[float], None] = lambda share: None,
) -> bytes:
    """An object file of some parts and all that they call, for every processor of a platform.

    It is kept, too: where no part is another one, as after an edit of comments, it is the same.

    Args:
        roots: see `link`. target: see `target_of`.
        report: is called after each stage with the share of the time that is usually over then.
    """
    plain = target.triple.partition("-")[0] in PLAIN
    made_of = sha256(f"{_machinery()} {target.triple} {target.target_data}".encode())
    for part in _needed(roots):
        if plain and not part.plain:
            raise OscContactError(
                f"{part.symbol} was translated after numba had compiled other functions, so it is "
                f"not there as {target.triple} needs it: translate it in a process of its own"
            )
        made_of.update(sha256(part.plain if plain else part.code).digest())
    for name, part in roots.items():
        made_of.update(f"{name} {part.symbol}".encode())
    key = f"object-{made_of.hexdigest()}"
    kept = _store().find(key)
    if kept is not None:
        return kept
    module = link(roots, target, plain)
    module.triple = target.triple
    module.data_layout = str(target.target_data)
    module.verify()
    report(0.05)
    builder = _pass_builder(target)
    builder.getModulePassManager().run(module, builder)
    report(0.8)
    made = bytes(target.emit_object(module))
    _store().keep(key, made)
    _store().remove_old(KEPT)
    return made

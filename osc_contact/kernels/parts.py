"""The parts of a kernel as numba compiles them: into LLVM code only, to be inlined where called.

numba optimises every function and turns it into machine code, whether Python can call it or not.
Parts are called by the kernel alone, which is optimised as a whole with all of them in it: half the
time to compile, and faster code. This builds on numba's own compiler classes, so its version is
bounded in pyproject.toml.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.typed_passes import NopythonTypeInference
from numba.core.types import unliteral

__all__ = ["PartCompiler", "once_per_type"]


class _Nobody:
    """Stands for a code generator where there is no machine code to be told of anything."""

    def set_env(self, name: str, env: Any) -> None:
        pass


class _PartLibrary(JITCodeLibrary):
    """Code that is linked into its callers, and left as it is until then."""

    codegen = _Nobody()

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0


@register_pass(mutates_CFG=False, analysis_only=False)
class _AsPart(FunctionPass):
    """Chooses the library that the code goes to."""

    _name = "as_part"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        return True


class PartCompiler(CompilerBase):
    """numba's compiler without the machine code."""

    def define_pipelines(self) -> Any:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.add_pass_after(_AsPart, NopythonTypeInference)
        passes.finalize()
        return [passes]


def once_per_type(part: Any) -> Any:
    """A part that is compiled once for all integers, not again for each constant it is given."""
    template = part.get_call_template

    def get_call_template(args: Any, kws: Any) -> Any:
        return template(tuple(unliteral(arg) for arg in args), kws)

    part.get_call_template = get_call_template
    return part

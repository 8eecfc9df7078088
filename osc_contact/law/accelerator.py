"""Compiles the parts of the law into LLVM code only: half the time of the first compilation.

numba optimises every function and turns it into machine code, whether Python can call it or not.
The parts of the law are called by its entry alone, which is optimised as a whole with all of them
in it. This rests on numba's own compiler classes, which may change: whatever goes wrong here, `jit`
compiles with public numba instead, to the same code. OSC_CONTACT_ACCELERATOR=0 leaves it out.
"""

from __future__ import annotations

from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.typed_passes import NopythonTypeInference

__all__ = ["entry_options", "part_options"]


class _NoSymbols:
    """Stands for a code generator where there is no machine code whose symbols could be set."""

    def set_env(self, name: str, env: Any) -> None:
        pass


class _PartLibrary(JITCodeLibrary):
    """Code that is linked into its callers, and left as it is until then."""

    codegen = _NoSymbols()

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


def part_options() -> dict[str, Any]:
    """Options of `numba.njit` for functions that only compiled functions call.

    `_nrt`: the law makes no arrays, so nothing needs to be counted.
    """
    return {
        "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "pipeline_class": PartCompiler,
        "_nrt": False,
    }  # fmt: skip


def entry_options() -> dict[str, Any]:
    """The same for functions that Python calls."""
    return {"no_cfunc_wrapper": True, "_nrt": False}

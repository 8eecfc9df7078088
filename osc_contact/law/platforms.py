"""Platforms for which the law is compiled: processors, pointer sizes, LLVM's targets and passes."""

from __future__ import annotations

import platform
from functools import cache

from llvmlite import binding as llvm
from llvmlite import ir

from osc_contact.errors import OscContactError

#: Target processor of each platform, the baseline that all of its processors support.
BASELINE = {
    "x86_64": "x86-64",
    "AMD64": "x86-64",
    "aarch64": "generic",
    "arm64": "generic",
    "wasm32": "generic",
}
#: Platforms whose pointers have another size than those of machines with numba.
PLAIN = ("wasm32",)


def target_of(triple: str = "") -> llvm.TargetMachine:
    """Target machine of LLVM for the baseline processor of a platform.

    Args:
        triple: LLVM's name of a platform; empty: this platform, with the features of the present
            processor if BASELINE does not list the platform.

    Raises:
        OscContactError: BASELINE does not list the platform of `triple`.
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
def own_target() -> llvm.TargetMachine:
    """Target machine of this platform, made once."""
    return target_of()


def pass_builder(target: llvm.TargetMachine) -> llvm.PassBuilder:
    """Builder of LLVM's optimisation passes for a target.

    Loops of the law are short (arms, joints, columns of N), so that vectorised and specialised
    copies of them (level 3) cost instruction cache and gain nothing. Vectorisation of straight-line
    code makes ticks faster.

    Args:
        target: processor for which machine code is made.
    """
    tuning = llvm.create_pipeline_tuning_options(2)
    tuning.loop_vectorization = False
    tuning.slp_vectorization = True
    return llvm.create_pass_builder(target, tuning)


def pointer_bytes(layout: str) -> int:
    """Size of a pointer (bytes) on a platform.

    Args:
        layout: data layout of LLVM for the platform.
    """
    return int(ir.IntType(8).as_pointer().get_abi_size(llvm.create_target_data(layout)))

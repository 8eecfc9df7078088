"""Types of objects of numba and LLVM, for annotations only: it is imported by no running program.

An intrinsic of numba returns the signature of a call, and the function that generates its code.
"""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
from llvmlite import ir
from numba.core.cpu import CPUContext as CPUContext
from numba.core.types import IntegerLiteral as IntegerLiteral
from numba.core.types import Type as Type
from numba.core.typing.context import BaseContext
from numba.core.typing.templates import Signature as Signature

TypingContext: TypeAlias = BaseContext
Builder: TypeAlias = ir.IRBuilder
Value: TypeAlias = ir.Value
Values: TypeAlias = Sequence[ir.Value]
Intrinsic: TypeAlias = tuple[Signature, Callable[[CPUContext, Builder, Signature, Values], Value]]


class Layout(Protocol):
    """Layout of a record, which `nested.Nested` declares: its head and its tables.

    Attributes:
        dtype: fields of the head.
        tables: by name, dtype of a row (or element) and sizes.
    """

    dtype: np.dtype[Any]
    tables: dict[str, tuple[np.dtype[Any], list[Any]]]

    def slot(self, size: str) -> int:
        """Number of the word of the layout that contains a count, such as the number of arms.

        Args:
            size: name of the count in the declaration of the record.
        """

    def start(self, table: str) -> int:
        """Number of the word of the layout that contains the offset of a table.

        Args:
            table: name of the table.
        """

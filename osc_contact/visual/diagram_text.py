"""The words of a diagram: signals as formulas, folded names and equations, sizes in inches."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["EQUATION_SIZE", "NAME_SIZE", "SIGNAL_SIZE", "Words", "folded_equation", "folded_name"]

NAME_SIZE, EQUATION_SIZE, SIGNAL_SIZE = 9.5, 9.0, 8.5
_GREEK = re.compile(
    "alpha|beta|gamma|delta|epsilon|eta|theta|vartheta|lambda|Lambda|mu|nu|xi|rho|sigma|tau|phi|"
    "Phi|psi|omega|Omega"
)


class Words:
    """Texts as they will stand in the figure, and their sizes there.

    Attributes:
        labels: how a signal is written, for those that shall not be written as `formula` does.
    """

    def __init__(self, ax: Axes, labels: Mapping[str, str]) -> None:
        self.ax = ax
        self.labels = dict(labels)

    def label(self, signal: str) -> str:
        """The signal's name in the figure."""
        return self.labels.get(signal) or formula(signal)

    def size(self, text: str, size: float, weight: str = "normal") -> tuple[float, float]:
        """Width and height of a text in inches."""
        if not text:
            return 0.0, 0.0
        figure: Any = self.ax.get_figure(root=True)
        probe = self.ax.text(0.0, 0.0, text, size=size, weight=weight)
        box = probe.get_window_extent(figure.canvas.get_renderer())
        probe.remove()
        return box.width / figure.dpi, box.height / figure.dpi

    def label_width(self, label: str) -> float:
        """Room that a signal's name takes along a wire (in)."""
        return self.size(label, SIGNAL_SIZE)[0] + 0.08 if label else 0.0


def formula(signal: str) -> str:
    """``alpha_meas`` as a formula; what holds a $ stays as it is; words stay upright."""
    if "$" in signal:
        return signal
    head, _, index = signal.partition("_")
    index = index.replace("_", r"\,")
    greek = _GREEK.fullmatch(head)
    if not greek and len(head) > 1:
        return rf"$\mathrm{{{head}}}_{{\mathrm{{{index}}}}}$" if index else signal
    symbol = rf"\{head}" if greek else head
    if not index:
        return f"${symbol}$"
    return rf"${symbol}_{{\mathrm{{{index}}}}}$"


def folded_name(name: str) -> str:
    """A block's name on lines of at most 13 letters."""
    return "\n".join(textwrap.wrap(name, 13, break_long_words=False)) or name


def folded_equation(equation: str, longest: int = 26) -> str:
    """A long equation on two lines: broken at a comma outside mathtext, or before its number."""
    equation = equation.replace(r"\!", "")  # mathtext sets integrals tight enough
    if "\n" in equation or len(equation) <= longest:
        return equation
    number = re.search(r"\s+(\([0-9a-z., ]+\))$", equation)
    if number:
        return f"{equation[: number.start()]}\n{number.group(1)}"
    commas = [m.start() for m in re.finditer(", ", equation)]
    for at in commas:
        if equation[:at].count("$") % 2 == 0:
            return f"{equation[: at + 1]}\n{equation[at + 2 :]}"
    return equation

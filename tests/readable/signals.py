"""The signals and boxes of fig. 4: a tick's signals, and which box reads and writes them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from osc_contact.contacts.contact import Contact
from osc_contact.control.signals import Block
from osc_contact.dynamics.closed_chain import ChainState
from osc_contact.dynamics.environment import Environment
from osc_contact.interface import Reference, Touched
from osc_contact.spatial import Array

if TYPE_CHECKING:
    from readable.controller import ReadableController as Controller

__all__ = ["Signals", "Stage", "TracedSignals", "block", "observed"]


class Signals:
    """The signals of fig. 4, as attributes; their values after a tick are those of that tick."""

    q: Array  #: (n,) encoders
    v: Array  #: (n,)
    wrenches: Array  #: (arms, 6) wrist sensors
    touched: Touched | None  #: pose, twist, known acceleration of the touched bodies
    reference: Reference  #: desired pose, twist, acceleration of the object
    alpha_d: Array  #: (r_all,) desired contact forces
    squeeze_d: float | Array  #: desired internal force
    state: ChainState  #: Λ_S, μ, p, S, σ, G of the closed chain
    parts: list[Contact]  #: N, n_γ of each contact
    contact: Contact  #: N, T, n_γ of all together
    friction_wrenches: Array  #: (6, r) friction for each newton of contact force, N_μ − N
    environment: Environment  #: Φ_e, b_e, V_e
    f_meas: Array  #: (6,) sum of the wrist readings at O, tare removed
    f_c_meas: Array  #: (6,) contact force inside it
    alpha_meas: Array  #: (r,) its magnitudes
    alpha_u: Array  #: (r,) force command
    f_ccomm: Array  #: (6,) the same in operational space
    a_u: Array  #: (6,) motion command
    eta_c: Array  #: (d,) filtered motion command
    f_S: Array  #: (d,) generalised force
    tau: Array  #: (n_a,) motor torques

    def __getattr__(self, name: str) -> Any:
        """After a compiled tick the signals are worked out when somebody first looks at one."""
        fill = self.__dict__.pop("_fill", None)
        if fill is None or name.startswith("_"):
            raise AttributeError(f"no tick has set the signal '{name}'")
        fill()
        return getattr(self, name)


Stage = Callable[[Any, Signals], None]


def block(name: str, group: str, equation: str) -> Callable[[Stage], Stage]:
    """Mark a method as one box of the figure."""

    def mark(stage: Stage) -> Stage:
        stage.block = Block(name, group, equation)  # type: ignore[attr-defined]
        return stage

    return mark


class TracedSignals(Signals):
    """Signals that remember who read and wrote what."""

    def begin(self) -> None:
        self.__dict__["_reads"], self.__dict__["_writes"] = [], []

    def seen(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return tuple(self.__dict__["_reads"]), tuple(self.__dict__["_writes"])

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        log = super().__getattribute__("__dict__").get("_reads")
        if log is not None and name in Signals.__annotations__ and name not in log:
            log.append(name)
        return value

    def __setattr__(self, name: str, value: Any) -> None:
        log = self.__dict__.get("_writes")
        if log is not None and name not in log:
            log.append(name)
        super().__setattr__(name, value)


def observed(
    controller: Controller, stages: Sequence[Stage], signals: TracedSignals
) -> list[Block]:
    """Run the stages one by one; each box with the signals it really read and wrote."""
    blocks = []
    for stage in stages:
        signals.begin()
        stage(controller, signals)
        own: Block = stage.block  # type: ignore[attr-defined]
        blocks.append(Block(own.name, own.group, own.equation, *signals.seen()))
    return blocks

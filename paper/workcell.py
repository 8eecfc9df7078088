"""The real workcell of section 6, one trouble at a time: what each costs the contact forces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

import osc_contact as osc
from osc_contact.visual import OKABE_ITO
from osc_contact.visual.plots import style
from paper.study import Ask, Data, Study, table_of, words_of

SCENARIO = "workcell"
_IDEAL = {
    "joints": (
        "plant.flexible_joints=null",
        "plant.motors=null",
        "plant.joint_friction=0",
        "control.joint_torque=null",
    ),
    "sensors": ("sensors={}",),
    "contact friction": ("plant.friction=0", "control.friction=null"),
    "model": ("model_error={}",),
}


def _only(*kept: str) -> tuple[str, ...]:
    return tuple(change for name, off in _IDEAL.items() if name not in kept for change in off)


#: What is real in each run → how the scenario is changed to make the rest ideal.
STAGES: dict[str, tuple[str, ...]] = {
    "nothing": _only(),
    "joints": _only("joints"),
    "joints, no torque loop": (*_only("joints"), "control.joint_torque=null"),
    "sensors": _only("sensors"),
    "contact friction": _only("contact friction"),
    "contact friction, not compensated": (*_only("contact friction"), "control.friction=null"),
    "everything": (),
}


@dataclass(frozen=True)
class Rung:
    """One run: what was real, and its verdict; None: the simulation diverged."""

    real: str
    verdict: Data | None

    def worst(self, key: str) -> float | None:
        """The largest of a number of `metrics`' force entries over the contacts."""
        if self.verdict is None:
            return None
        return max(force[key] for force in self.verdict["force"].values())

    @property
    def closed(self) -> float | None:
        """The smallest contact fraction."""
        return None if self.verdict is None else min(self.verdict["contact_fraction"].values())

    def as_dict(self) -> Data:
        """JSON-able."""
        return {
            "force_rms_rel": self.worst("rms_error_rel"),
            "force_peak_rel": self.worst("peak_error_rel"),
            "sensing_rms_rel": self.worst("sensing_rms_rel"),
            "contact_fraction": self.closed,
        }


def ladder(
    stages: Iterable[str] = tuple(STAGES),
    duration: float = 8.0,
    seed: int = 0,
    overrides: Sequence[str] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> list[Rung]:
    """Run the workcell with only part of it real, stage by stage.

    Args:
        stages: names from `STAGES`; default: all.
        duration: s of each run. seed: of everything random.
        overrides: further changes of every run. progress: called with the stage's name.

    Raises:
        InvalidInputError: unknown stage.
    """
    rungs = []
    for name in stages:
        if name not in STAGES:
            raise osc.InvalidInputError(f"no stage '{name}'; there are {', '.join(STAGES)}")
        progress(name)
        scenario = osc.load_scenario(SCENARIO, [*STAGES[name], *overrides])
        try:
            rungs.append(Rung(name, osc.metrics(osc.run(scenario, duration=duration, seed=seed))))
        except osc.PlantError:
            rungs.append(Rung(name, None))
    return rungs


def draw(rungs: Sequence[Rung]) -> Figure:
    """Force error of each run, logarithmic; runs that diverged have no bar."""
    errors = [100 * (rung.worst("rms_error_rel") or 0.0) for rung in rungs]
    with style():
        figure = Figure(figsize=(6.4, 0.6 + 0.42 * len(rungs)), layout="constrained")
        ax = figure.subplots()
        bars = ax.barh([rung.real for rung in rungs], errors, color=OKABE_ITO["blue"])
        words = [
            "diverged" if rung.verdict is None else f"{error:.2g} %"
            for rung, error in zip(rungs, errors, strict=True)
        ]
        ax.bar_label(bars, words, padding=3)
        ax.set_xscale("log")
        ax.set_xlim(1e-2, 1e4)
        ax.invert_yaxis()
        ax.set_xlabel("force error, rms (% of the mean command), worse contact")
    return figure


def study(ask: Ask) -> Study:
    """All stages."""
    rungs = ladder(STAGES, ask.lasting(8.0), ask.seed, ask.changes, ask.tell)
    data = {rung.real: rung.as_dict() for rung in rungs}
    rows = (
        (real, *(words_of(value, "{:.3%}", "diverged") for value in errors.values()))
        for real, errors in data.items()
    )
    heads = "what is real; force, rms; peak; sensed within; closed"
    return Study({"workcell": draw(rungs)}, table_of("workcell", heads, rows), data)

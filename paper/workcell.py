"""The real workcell of section 6, one trouble at a time: what each costs the contact forces."""

from collections.abc import Iterable, Iterator, Sequence
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
        forces = () if self.verdict is None else self.verdict["force"].values()
        return max((force[key] for force in forces), default=None)

    def as_dict(self) -> Data:
        """JSON-able."""
        return {
            "force_rms_rel": self.worst("rms_error_rel"),
            "force_peak_rel": self.worst("peak_error_rel"),
            "sensing_rms_rel": self.worst("sensing_rms_rel"),
            "contact_fraction": self.verdict and min(self.verdict["contact_fraction"].values()),
        }


def ladder(stages: Iterable[str], ask: Ask) -> Iterator[Rung]:
    """Run the workcell with only part of it real, stage by stage.

    Args:
        stages: names from `STAGES`.
        ask: duration (default: 8 s) and seed of each run, further changes of it.

    Raises:
        InvalidInputError: unknown stage.
    """
    for name in stages:
        if name not in STAGES:
            raise osc.InvalidInputError(f"no stage '{name}'; there are {', '.join(STAGES)}")
        ask.tell(name)
        scenario = osc.load_scenario(SCENARIO, [*STAGES[name], *ask.changes])
        try:
            recording = osc.run(scenario, duration=ask.lasting(8.0), seed=ask.seed)
            yield Rung(name, osc.metrics(recording))
        except osc.PlantError:
            yield Rung(name, None)


def draw(rungs: Sequence[Rung]) -> Figure:
    """Force error of each run, logarithmic; runs that diverged have no bar."""
    errors = [100 * (rung.worst("rms_error_rel") or 0.0) for rung in rungs]
    with style():
        figure = Figure(figsize=(6.4, 0.6 + 0.42 * len(rungs)), layout="constrained")
        ax = figure.subplots()
        bars = ax.barh([rung.real for rung in rungs], errors, color=OKABE_ITO["blue"])
        ax.bar_label(
            bars, [f"{error:.2g} %" if error else "diverged" for error in errors], padding=3
        )
        label = "force error, rms (% of the mean command), worse contact"
        ax.set(xscale="log", xlim=(1e-2, 1e4), xlabel=label)
        ax.invert_yaxis()
    return figure


def study(ask: Ask) -> Study:
    """All stages."""
    rungs = list(ladder(STAGES, ask))
    data = {rung.real: rung.as_dict() for rung in rungs}
    rows = (
        (real, *(words_of(value, "{:.3%}", "diverged") for value in errors.values()))
        for real, errors in data.items()
    )
    heads = "what is real; force, rms; peak; sensed within; closed"
    return Study({"workcell": draw(rungs)}, table_of("workcell", heads, rows), data)

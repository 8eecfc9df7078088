"""The real workcell of section 6, one trouble at a time: what each costs the contact forces."""

from collections.abc import Iterable, Iterator

import osc_contact as osc
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


_WORST = {
    "force_rms_rel": "rms_error_rel",
    "force_peak_rel": "peak_error_rel",
    "sensing_rms_rel": "sensing_rms_rel",
}


def ladder(stages: Iterable[str], ask: Ask) -> Iterator[tuple[str, Data]]:
    """Run the workcell with only part of it real: each stage and its errors, the worst contact's.

    Where the simulation diverged they are None.

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
            verdict = osc.metrics(osc.run(scenario, duration=ask.lasting(8.0), seed=ask.seed))
        except osc.PlantError:
            yield name, dict.fromkeys((*_WORST, "contact_fraction"))
            continue
        forces = verdict["force"].values()
        row = {key: max(force[of] for force in forces) for key, of in _WORST.items()}
        yield name, row | {"contact_fraction": min(verdict["contact_fraction"].values())}


def study(ask: Ask) -> Study:
    """All stages."""
    data = dict(ladder(STAGES, ask))
    rows = (
        (real, *(words_of(value, "{:.3%}", "diverged") for value in errors.values()))
        for real, errors in data.items()
    )
    heads = "what is real; force, rms; peak; sensed within; closed"
    return Study({}, table_of("workcell", heads, rows), data)

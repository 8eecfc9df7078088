"""One scenario with changes, run by run: what a moving face and what each real part costs.

`moving_face`: its left face is driven to and fro, without and with a turn, or rides on a free cart,
on a cart with a return spring, or on a hinge with one. Each time the full law is compared with one
that sees the face's pose and velocity but takes it as unyielding and unaccelerated (Φ_e and b_e of
eqs. 14 to 25). `workcell`: one part after another of section 6 is real.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

import osc_contact as osc
from osc_contact.lab.visual import plots
from osc_contact.recorder.judged import judged_ticks
from paper.study import Ask, Data, Study, table_of


class Variant(NamedTuple):
    """A run of a study.

    Attributes:
        changes: overrides of the scenario.
        limit: of the largest force error (rms, of the mean command); None: the run shows a cost.
    """

    changes: tuple[str, ...]
    limit: float | None = None


_SWING = "[{type: sine, amplitude: 30 mm, frequency: 1 Hz, start: 0 s, ramp: 2 s}]"
_TURN = (
    "{axis: [-0.371390, 0.928477, 0], through: [-0.295, -0.002, 0.19], "
    "signals: [{type: sine, amplitude: 5 deg, frequency: 0.7 Hz, start: 0 s, ramp: 2 s}]}"
)
_DRIVEN = "type: conveyor, direction: [-0.904196, -0.361677, 0.227199], signals: " + _SWING
#: Changes of `moving_face`; the hinge is 0.1 m below the contact, along the face.
FACES: dict[str, tuple[str, ...]] = {
    "conveyor": (f"contacts.left_end.face.motion={{{_DRIVEN}}}",),
    "turning conveyor": (f"contacts.left_end.face.motion={{{_DRIVEN}, turn: {_TURN}}}",),
    "free cart": (),
    "cart with spring": (
        "contacts.left_end.face.motion.stiffness=100",
        "contacts.left_end.face.motion.damping=5",
    ),
    "hinge with spring": (
        "contacts.left_end.face.motion={type: hinge, axis: [-0.371390, 0.928477, 0], "
        "through: [-0.216847, 0.029262, 0.137610], inertia: 0.02, stiffness: 10, damping: 0.3, "
        "preload: 1 Nm}",
    ),
}
_IDEAL = {
    "joints": (
        "plant.flexible_joints=null",
        "plant.motors=null",
        "plant.joint_friction=0",
        "control.joint_torque=null",
    ),
    "sensors": ("sensors={}",),
    "friction": ("plant.friction=0", "control.friction=null"),
    "model": ("model_error={}",),
}


def only(real: str = "") -> tuple[str, ...]:
    """Changes of `workcell` that make all of it ideal but a part: joints, sensors, friction."""
    return tuple(change for part, off in _IDEAL.items() if part != real for change in off)


#: By scenario, which gives the study its name.
VARIANTS: dict[str, Mapping[str, Variant]] = {
    "moving_face": {
        f"{face}, {law}": Variant((*changes, f"model_error.environment={known}"), limit)
        for face, changes in FACES.items()
        for law, known, limit in (("full law", "known", 0.01), ("no Φ_e, b_e", "ignored", None))
    },
    "workcell": {
        "ideal": Variant(only(), 0.01),
        "flexible joints, motors": Variant(only("joints"), 0.05),
        "… no torque loop": Variant((*only("joints"), "control.joint_torque=null")),
        "sensors": Variant(only("sensors"), 0.08),
        "contact friction": Variant(only("friction"), 0.02),
        "… not compensated": Variant((*only("friction"), "control.friction=null")),
        "everything": Variant((), 0.08),
    },
}


class Result(NamedTuple):
    """Run of a variant, as it is shown.

    Attributes:
        recording: recording with the channels of its force errors.
        judged: ticks that are judged.
        verdict: verdict on the whole run.
    """

    recording: osc.Recording
    judged: plots.Judged
    verdict: Data


def run(scenario: str, changes: Sequence[str], duration: float, seed: int) -> Result:
    """Run a variant.

    Args:
        scenario: scenario with these changes.
        duration: s.
        seed: of everything random.
    """
    recording = osc.run(osc.load_scenario(scenario, changes), duration=duration, seed=seed)
    kept = {name: np.array(recording[name]) for name in ("t", "alpha_cmd", "alpha_true")}
    judged = judged_ticks(recording)[0]
    return Result(osc.Recording(recording.meta, kept), judged, osc.metrics(recording))


def runs(scenario: str, ask: Ask) -> dict[str, Callable[[], Result]]:
    """The runs of all variants of a scenario, by name; see `compare`."""
    return {
        name: partial(run, scenario, [*variant.changes, *ask.changes], ask.lasting(8.0), ask.seed)
        for name, variant in VARIANTS[scenario].items()
    }


def compare(scenario: str, ask: Ask) -> Study:
    """Force errors of every variant of a scenario, the larger of both ends, and contact kept.

    Args:
        scenario: name in `VARIANTS`.
        ask: duration (default: 8 s) and seed of every run; further changes of the scenario.
    """
    results = ask.results(runs(scenario, ask))
    data = {}
    rows = []
    with plots.style():
        figure, axes = plots.panels(len(results), 1.4)
        for (name, (recording, judged, verdict)), ax in zip(results.items(), axes, strict=True):
            limit = VARIANTS[scenario][name].limit
            plots.draw_errors(ax, recording, judged, linear=1.0)
            ax.set_title(name)
            error = max(force["rms_error_rel"] for force in verdict["force"].values())
            closed = min(verdict["contact_fraction"].values())
            data[name] = {"force_rms_rel": error, "limit": limit, "contact_fraction": closed}
            most = "" if limit is None else f"{limit:.0%}"
            rows.append((name, verdict["task"]["word"], f"{error:.3%}", most, f"{closed:.2%}"))
    table = table_of(f"{scenario} on mujoco", "variant; verdict; force, rms; limit; closed", rows)
    return Study({scenario: figure}, table, data)

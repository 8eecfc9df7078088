"""A face that moves while it is pressed: what Φ_e and b_e in the law are worth (eqs. 14 to 25).

The left face of `moving_face` is driven to and fro, without and with a turn, or rides on a free
cart, on a cart with a return spring, or on a hinge with one. Each time the full law is compared
with one that sees the face's pose and velocity but takes it as unyielding and unaccelerated.
"""

from collections.abc import Callable, Iterable
from itertools import product

import numpy as np

import osc_contact as osc
from osc_contact.spatial import Array
from paper.study import Ask, Data, Study, table_of

_SWING = "[{type: sine, amplitude: 30 mm, frequency: 1 Hz, start: 0 s, ramp: 2 s}]"
_TURN = (
    "{axis: [-0.371390, 0.928477, 0], through: [-0.295, -0.002, 0.19], "
    "signals: [{type: sine, amplitude: 5 deg, frequency: 0.7 Hz, start: 0 s, ramp: 2 s}]}"
)
_DRIVEN = "type: conveyor, direction: [-0.904196, -0.361677, 0.227199], signals: " + _SWING
#: What is changed in the packaged scenario; the hinge is 0.1 m below the contact, along the face.
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
LAWS = {"full law": "known", "without Φ_e, b_e": "ignored"}


def run(
    plant: str = "mujoco",
    duration: float = 10.0,
    faces: Iterable[str] = FACES,
    tell: Callable[[str], None] = lambda _: None,
) -> list[Data]:
    """Every face under both laws: errors of both contact forces, contact kept, travel of the face.

    Args:
        plant: "mujoco" or "rigid". duration: of each run (s), more than the 1 s it settles.
        faces: keys of `FACES`.
        tell: called with what runs next.
    """
    cases = []
    for face, law in product(faces, LAWS):
        tell(f"{face}, {law}")
        changes = [*FACES[face], f"model_error.environment={LAWS[law]}", f"plant.type={plant}"]
        recording = osc.run(osc.load_scenario("moving_face", changes), duration=duration)
        verdict = osc.metrics(recording)
        force = verdict["force"]
        row = {
            "face": face,
            "law": law,
            **{f"{name}_rms_error_rel": f["rms_error_rel"] for name, f in force.items()},
            "left_end_peak_error_N": force["left_end"]["peak_error_N"],
            "contact_fraction": min(verdict["contact_fraction"].values()),
            "travel_m": float(np.ptp(_travel(recording))),
        }
        cases.append(row)
    return cases


def _travel(recording: osc.Recording) -> Array:
    """(T,) how far the left face is from where it started, with the sign of its first axis (m)."""
    path = recording["face_pose"][:, 0, :3] - recording["face_pose"][0, 0, :3]
    return -np.sign(path[:, 0]) * np.linalg.norm(path, axis=1)


def study(ask: Ask) -> Study:
    """All faces under both laws."""
    data = run(duration=ask.lasting(10.0), tell=ask.tell)
    table = table_of(
        "moving_face on mujoco",
        "left face; law; left force, rms; peak; right force, rms; closed; face travels",
        (
            f"{row['face']}; {row['law']}; {row['left_end_rms_error_rel']:.3%}; "
            f"{row['left_end_peak_error_N']:.3f} N; {row['right_end_rms_error_rel']:.3%}; "
            f"{row['contact_fraction']:.2%}; {1e3 * row['travel_m']:.1f} mm"
            for row in data
        ),
    )
    return Study({}, table, {"cases": data})

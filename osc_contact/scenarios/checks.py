"""Checks across the keys of a scenario: names that belong together, times that divide."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from osc_contact.scenarios.bodies import magnitude_names, raw_magnitudes
from osc_contact.scenarios.control_schema import ControlSpec
from osc_contact.scenarios.hardware import PlantSpec
from osc_contact.scenarios.quantities import did_you_mean

Problem = tuple[tuple[str | int, ...], str]
"""Where (keys and list indices) and what is wrong."""


def name_problems(
    arms: Sequence[str],
    contacts: Sequence[str],
    grasps: Iterable[str],
    force: Iterable[str],
    magnitudes: Mapping[str, int],
) -> list[Problem]:
    """Check that names are unique, that each arm has a grasp and each contact its forces.

    `magnitudes`: the number of forces by contact name.

    Args:
        arms, contacts, grasps: names. force: keys of `reference.force`.
        magnitudes: number of forces by contact name.
    """
    grasps = list(grasps)
    force = list(force)
    problems = list[Problem]()
    for key, names in (("arms", arms), ("contacts", contacts)):
        for index, name in enumerate(names):
            if Counter(names[:index])[name]:
                text = f"the name {name!r} is taken by an earlier item of {key}; names are unique"
                problems.append(((key, index, "name"), text))
    for key, given, expected, kind, example in (
        ("grasps", grasps, arms, "arm", "{xyz: [0, 0, 0], rpy: [0, 0, 0]}"),
        (
            "force",
            force,
            magnitude_names(magnitudes),
            "contact",
            "[{type: constant, value: 0 N}]",
        ),
    ):
        for name in given:
            if name not in expected:
                text = f"no {kind} has this name; {did_you_mean(name, expected)}"
                if kind == "contact" and magnitudes.get(name, 1) > 1:
                    text = f"this contact has {magnitudes[name]} forces; " + (
                        f"give each its own entry, {name}.1 to {name}.{magnitudes[name]}"
                    )
                problems.append(((key, name), text))
        for name in dict.fromkeys(expected):
            if name not in given:
                text = f"the {kind} {name!r} has no entry; add {name}: {example}"
                problems.append(((key,), text))
    return problems


def body_problems(bodies: Sequence[str], used: Sequence[str | None]) -> list[Problem]:
    """Check that bodies have different names and that contacts are on bodies that exist.

    `used`: the body of each contact, None where it brings its own face.
    """
    problems = list[Problem]()
    for index, name in enumerate(bodies):
        if name in bodies[:index]:
            text = f"the name {name!r} is taken by an earlier item of environment; names are unique"
            problems.append((("environment", index, "name"), text))
        if name not in used:
            text = f"no contact is on the body {name!r}; give one its name as body, or remove it"
            problems.append((("environment", index), text))
    for index, body in enumerate(used):
        if body is not None and body not in bodies:
            text = f"no body of environment has this name; {did_you_mean(body, bodies)}"
            problems.append((("contacts", index, "body"), text))
    return problems


def timing_problems(control: ControlSpec, plant: PlantSpec) -> list[Problem]:
    """Check that the control period is a whole multiple of the plant step (within 1e-9), and so
    for the joint torque loop; and that the plant has the drives required."""
    return [
        *_step_problems(control, plant),
        *_torque_loop_problems(control, plant),
        *_rigid_problems(plant),
    ]


def _rigid_problems(plant: PlantSpec) -> Iterator[Problem]:
    """Exact plants have ideal joints."""
    if plant.exact:
        for key in ("flexible_joints", "motors", "joint_friction", "pushes"):
            if getattr(plant, key):
                text = (
                    "an exact plant has ideal joints and contacts that do not open; leave it out, "
                    "or take plant.type mujoco"
                )
                yield ("plant", key), text


def _torque_loop_problems(control: ControlSpec, plant: PlantSpec) -> Iterator[Problem]:
    loop = control.joint_torque
    if loop is None:
        return
    key = ("control", "joint_torque")
    if plant.flexible_joints is None:
        text = (
            "a joint torque loop acts on springs, and the joints are stiff; add "
            "plant.flexible_joints, or leave it out"
        )
        yield key, text
    calls = loop.rate / control.rate
    steps = 1.0 / (loop.rate * plant.step)
    if not all(round(n) >= 1 and abs(n - round(n)) <= 1e-9 for n in (calls, steps)):
        text = (
            f"the loop runs {calls:.9g} times in a control period and {steps:.9g} plant steps pass "
            f"in its period (control.rate {control.rate:g} Hz, plant.step {plant.step:g} s); both "
            "must be whole numbers"
        )
        yield (*key, "rate"), text


def _step_problems(control: ControlSpec, plant: PlantSpec) -> list[Problem]:
    steps = 1.0 / (control.rate * plant.step)
    whole = round(steps)
    if whole >= 1 and abs(steps - whole) <= 1e-9:
        return []
    right = 1.0 / (control.rate * max(1, whole))
    text = (
        f"the control period is {steps:.9g} plant steps (control.rate {control.rate:g} Hz, "
        f"plant.step {plant.step:g} s); it must be a whole number of them, e.g. a step of "
        f"{right * 1e3:.9g} ms"
    )
    return [(("plant", "step"), text)]


def sound_problems(data: Any) -> Iterator[Problem]:
    """Run the checks across keys on raw data, each as far as its own keys are sound."""

    def names(key: str) -> list[str] | None:
        items = data.get(key, [])
        found = (
            [item.get("name") if isinstance(item, dict) else None for item in items]
            if isinstance(items, list)
            else [None]
        )
        named = [name if isinstance(name, str) else "" for name in found]
        return named if all(named) else None

    def group(key: str, fallback: list[str]) -> list[str]:
        given = data.get(key, {} if key == "force" else None)
        return list(given) if isinstance(given, dict) else fallback

    arms = names("arms")
    contacts = names("contacts")
    magnitudes = raw_magnitudes(data.get("contacts", []))
    if arms is not None:
        yield from name_problems(arms, [], group("grasps", arms), [], {})
    if contacts is not None:
        forces = {} if magnitudes is None else magnitudes
        given = group("force", magnitude_names(forces)) if magnitudes is not None else []
        yield from name_problems([], contacts, [], given, forces)
    bodies = names("environment")
    if bodies is not None and isinstance(data.get("contacts", []), list):
        items = data.get("contacts", [])
        used = [item.get("body") if isinstance(item, dict) else None for item in items]
        yield from body_problems(bodies, [name if isinstance(name, str) else None for name in used])
    try:
        control = ControlSpec.model_validate(data.get("control"))
        plant = PlantSpec.model_validate(data.get("plant"))
    except ValidationError:
        return
    yield from timing_problems(control, plant)

"""Checks across the keys of a scenario: names that belong together, times that divide."""

from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import ValidationError

from osc_contact.errors import did_you_mean
from osc_contact.lab.scenarios.contact_keys import ContactSpec, contact_types, magnitude_names
from osc_contact.lab.scenarios.hardware import PlantSpec
from osc_contact.settings.control import ControlSpec

Problem = tuple[tuple[str | int, ...], str]
"""Path of a key (keys and list indices), and the error with its cure."""


def problems_across(data: Mapping[str, Any]) -> Iterator[Problem]:
    """Yield contradictions between keys of a scenario; keys that are invalid are not compared.

    Args:
        data: keys of a scenario, from a file or validated.
    """
    names = {key: _names(data.get(key, ())) for key in ("arms", "contacts", "environment")}
    for key, items in names.items():
        for index, name in enumerate(items or ()):
            if items and name in items[:index]:
                text = f"the name {name!r} is taken by an earlier item of {key}; names are unique"
                yield (key, index, "name"), text
    arms = names["arms"]
    contact_names = names["contacts"]
    bodies = names["environment"]
    contacts = data.get("contacts", ())
    # keys of mappings must be names of arms and contacts, with entries of the right number
    if arms is not None:
        example = "{xyz: [0, 0, 0], rpy: [0, 0, 0]}"
        yield from _entries("grasps", "arm", data.get("grasps"), dict.fromkeys(arms, 1), example)
    yield from _plan_problems(data, contact_names)
    if contact_names is not None and data.get("plan") is None:
        forces = dict(zip(contact_names, map(_forces, contacts), strict=True))
        example = "[{type: constant, value: 0 N}]"
        yield from _entries("force", "contact", data.get("force", {}), forces, example)
    if contact_names is not None and isinstance(data.get("active"), dict):
        for name in data["active"]:
            if name not in contact_names:
                hint = did_you_mean(name, contact_names)
                yield ("active", name), f"no contact has this name; {hint}"
    # bodies that contacts name must exist, and all bodies must be named
    if bodies is not None and isinstance(contacts, list | tuple):
        touched = [_value(contact, "body") for contact in contacts]
        yield from _body_problems(bodies, touched)
    try:
        control = ControlSpec.model_validate(data.get("control"))
        plant = PlantSpec.model_validate(data.get("plant"))
    except ValidationError:
        return
    yield from _plant_problems(control, plant)
    if plant.type == "drake":
        yield from _drake_problems(plant, len(arms or ()))


#: Keys of a scenario that a plan replaces.
_OF_PLANS = ("force", "active", "motion", "squeeze", "tare")


def _plan_problems(data: Mapping[str, Any], contacts: list[str] | None) -> Iterator[Problem]:
    """Yield keys beside a plan that it replaces, and contacts of its stages that do not exist.

    Args:
        data: keys of a scenario.
        contacts: names of its contacts; None: they are not valid.
    """
    plan = data.get("plan")
    if plan is None:
        return
    for key in _OF_PLANS:
        if data.get(key):
            text = "the stages of the plan have their own; leave it out, or leave out plan"
            yield (key,), text
    stages = _value(plan, "stages")
    if contacts is None or not isinstance(stages, list | tuple):
        return
    for index, stage in enumerate(stages):
        forces = _value(stage, "forces")
        for name in forces if isinstance(forces, Mapping) else ():
            if name not in contacts:
                hint = did_you_mean(name, contacts)
                place = ("plan", "stages", index, "forces", name)
                yield place, f"no contact has this name; {hint}"


def _body_problems(bodies: list[str], touched: list[Any]) -> Iterator[Problem]:
    """Yield bodies of the environment without a contact, and contacts on unknown bodies.

    Args:
        bodies: names of the bodies.
        touched: key `body` of each contact; None: it has no such key.
    """
    for index, name in enumerate(bodies):
        if name not in touched:
            text = f"no contact is on the body {name!r}; give one its name as body, or remove it"
            yield ("environment", index), text
    for index, body in enumerate(touched):
        if isinstance(body, str) and body not in bodies:
            text = f"no body of environment has this name; {did_you_mean(body, bodies)}"
            yield ("contacts", index, "body"), text


def _value(item: Any, key: str) -> Any:
    """Value of a key of an item from a file, or of a validated item; None if it has no such key."""
    return item.get(key) if isinstance(item, dict) else getattr(item, key, None)


def _names(items: Any) -> list[str] | None:
    """Names of the items of a list; None if one of them is not valid."""
    if not isinstance(items, list | tuple):
        return None
    names = [_value(item, "name") for item in items]
    return names if all(isinstance(name, str) and name for name in names) else None


def _forces(contact: Any) -> Any:
    """Number r of force magnitudes of a contact; None if its type is not valid."""
    kind = contact
    if not isinstance(contact, ContactSpec):
        kind = contact_types().get(str(_value(contact, "type")))
    return kind and kind.forces


def has_one_force(scenario: Mapping[str, Any]) -> bool:
    """Test whether a scenario has a single contact, with a single force magnitude.

    Args:
        scenario: its groups, parsed or not.
    """
    contacts = scenario.get("contacts")
    return isinstance(contacts, list | tuple) and [_forces(one) for one in contacts] == [1]


def _entries(
    key: str, kind: str, group: Any, forces: Mapping[str, int], example: str
) -> Iterator[Problem]:
    """Yield missing and unknown entries of a group with an entry for each arm, or each force.

    Args:
        key: key of the group: grasps or force.
        kind: kind of the named items: arm or contact.
        group: entries by name.
        forces: number of entries of each item, by its name.
        example: example of an entry, for the message.
    """
    if not isinstance(group, Mapping) or None in forces.values():
        return
    expected = magnitude_names(forces)
    for name in group:
        if name not in expected:
            text = f"no {kind} has this name; {did_you_mean(name, expected)}"
            if forces.get(name, 1) > 1:
                text = (
                    f"this contact has {forces[name]} forces; give each its own entry, {name}.1 to "
                    f"{name}.{forces[name]}"
                )
            yield (key, name), text
    for name in expected:
        if name not in group:
            yield (key,), f"the {kind} {name!r} has no entry; add {name}: {example}"


def _plant_problems(control: ControlSpec, plant: PlantSpec) -> Iterator[Problem]:
    """Yield periods that are not whole multiples (within 1e-9), and drives the plant cannot have.

    Args:
        control: settings of control.
        plant: settings of the plant.
    """
    # the period of control, then that of a joint torque loop, in whole steps of the plant
    steps = 1.0 / (control.rate * plant.step)
    if not _is_whole(steps):
        whole_step = 1.0 / (control.rate * max(1, round(steps)))
        text = (
            f"the control period is {steps:.9g} plant steps (control.rate {control.rate:g} Hz, "
            f"plant.step {plant.step:g} s); it must be a whole number of them, e.g. a step of "
            f"{whole_step * 1e3:.9g} ms"
        )
        yield ("plant", "step"), text
    if not control.in_contact and (control.life is None or plant.exact):
        why = "contacts of a rigid plant cannot open; choose plant.type mujoco"
        if control.life is None:
            why = (
                "control.life opens them, and is off (the default of several forces beside a "
                "tare); give it, as {}"
            )
        yield ("control", "in_contact"), f"contacts do not begin open: {why}"
    if loop := control.joint_torque:
        key = ("control", "joint_torque")
        if plant.flexible_joints is None:
            text = (
                "a joint torque loop acts on springs, and the joints are stiff; add "
                "plant.flexible_joints, or leave it out"
            )
            yield key, text
        calls = loop.rate / control.rate
        steps = 1.0 / (loop.rate * plant.step)
        if not (_is_whole(calls) and _is_whole(steps)):
            text = (
                f"the loop runs {calls:.9g} times in a control period and {steps:.9g} plant steps "
                f"pass in its period (control.rate {control.rate:g} Hz, plant.step "
                f"{plant.step:g} s); both must be whole numbers"
            )
            yield (*key, "rate"), text
    # an exact plant integrates ideal joints in closed contacts
    if plant.exact:
        for drive in ("flexible_joints", "motors", "joint_friction", "pushes"):
            if getattr(plant, drive):
                text = (
                    "an exact plant has ideal joints and contacts that do not open; leave it out, "
                    "or take plant.type mujoco"
                )
                yield ("plant", drive), text


def _drake_problems(plant: PlantSpec, arms: int) -> Iterator[Problem]:
    """Yield keys of the plant that Drake's does not model.

    Args:
        plant: settings of the plant.
        arms: number of arms.
    """
    for key in ("flexible_joints", "motors", "joint_friction", "pushes"):
        if getattr(plant, key):
            text = (
                "the drake plant has ideal drives and no pushes; leave it out, or take plant.type "
                "mujoco"
            )
            yield ("plant", key), text
    for key in ("solref", "solimp"):
        if getattr(plant, key) != PlantSpec.model_fields[key].default:
            text = (
                "softness of MuJoCo's contacts, which the drake plant does not have; leave it out, "
                "and give plant.drake.stiffness and dissipation"
            )
            yield ("plant", key), text
    if plant.drake.contact == "tamsi" and arms > 1:
        text = (
            f"Drake's tamsi knows no constraints, and {arms} arms that hold one object are a loop; "
            "choose lagged"
        )
        yield ("plant", "drake", "contact"), text


def _is_whole(number: float) -> bool:
    """Return whether a positive number is a whole number up to rounding."""
    return round(number) >= 1 and abs(number - round(number)) <= 1e-9

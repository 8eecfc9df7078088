"""The register of plants: what stands in for robots and world, by its name in `plant.type`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from osc_contact import robots
from osc_contact.contacts.pairs.pair import ContactPair
from osc_contact.dynamics.closed_chain import ChainState, ClosedChain
from osc_contact.errors import ScenarioError
from osc_contact.plants.judge import Plant
from osc_contact.plants.mujoco import MujocoPlant
from osc_contact.plants.rigid import RigidPlant
from osc_contact.runs import faces, hardware
from osc_contact.runs.contacts import EnvironmentBody
from osc_contact.scenarios.hardware import PLANT_TYPES
from osc_contact.scenarios.schema import Scenario

__all__ = ["PLANTS", "Parts", "make_plant", "register_plant"]


@dataclass(frozen=True)
class Parts:
    """What a plant is made of.

    Attributes:
        scenario: that is run; its `plant` has the options.
        chain: the true arms and object. state: of the chain at rest, in contact.
        pairs: the contacts. bodies: of the environment. on: the body of each contact, by number.
        seed: of everything random.
    """

    scenario: Scenario
    chain: ClosedChain
    pairs: tuple[ContactPair, ...]
    bodies: tuple[EnvironmentBody, ...]
    on: tuple[int, ...]
    state: ChainState
    seed: int


MakesPlant = Callable[[Parts], Plant]
#: Every registered plant by its name in scenarios.
PLANTS: dict[str, MakesPlant] = {}


def register_plant(name: str, *, exact: bool = False) -> Callable[[MakesPlant], MakesPlant]:
    """Function decorator: enter a plant in the register, for `plant.type` of scenarios.

    Args:
        name: in scenarios.
        exact: its joints are ideal and its contacts neither open nor end: then no tare, motor
            error, push or edge of a face is asked of it.
    """

    def enter(make: MakesPlant) -> MakesPlant:
        PLANTS[name], PLANT_TYPES[name] = make, exact
        return make

    return enter


def make_plant(parts: Parts) -> Plant:
    """The plant that the scenario names, not yet at its start.

    Raises:
        ScenarioError: a tare on an exact plant.
    """
    spec = parts.scenario.plant
    if spec.exact and parts.scenario.tare is not None:
        raise ScenarioError(
            f"a tare needs contacts that open; the {spec.type} plant's are bilateral. "
            "Use plant.type=mujoco, or set tare: null"
        )
    return PLANTS[spec.type](parts)


@register_plant("rigid", exact=True)
def _rigid(parts: Parts) -> Plant:
    step, rails = parts.scenario.plant.step, faces.rails(parts.bodies)
    return RigidPlant(parts.chain, parts.pairs, step, rails, parts.on)


@register_plant("mujoco")
def _mujoco(parts: Parts) -> Plant:
    scenario, spec = parts.scenario, parts.scenario.plant
    return MujocoPlant(
        parts.chain,
        [robots.resolve_urdf(arm.urdf, scenario.folder)[0] for arm in scenario.arms],
        robots.resolve_urdf(scenario.object.urdf, scenario.folder)[0],
        parts.pairs,
        [(body.urdf[0], body.placement) for body in parts.bodies],
        spec,
        faces.rails(parts.bodies),
        parts.on,
        drives=hardware.drives(scenario, parts.chain, parts.state, parts.seed),
    )

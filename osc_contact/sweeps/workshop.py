"""Rigs of one study: what does not vary is made once."""

from __future__ import annotations

import json
from collections import OrderedDict

from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.runs.rig import Rig, build_chain, build_rig
from osc_contact.scenarios.schema import Scenario

__all__ = ["Workshop"]

_KEPT = 8  #: chains; where each run has masses of its own they are not wanted again


class Workshop:
    """Builds rigs; chains of the same arms, object and factors are the same chain.

    Not for use in several threads: chains hold scratch memory.
    """

    def __init__(self) -> None:
        """Begin with nothing made."""
        self._chains: OrderedDict[str, ClosedChain] = OrderedDict()

    def rig(self, scenario: Scenario) -> Rig:
        """See `build_rig`."""
        return build_rig(scenario, self._chain)

    def _chain(
        self,
        scenario: Scenario,
        arm_mass: float = 1.0,
        object_mass: float = 1.0,
        joint_friction: float = 1.0,
        hidden_mass: float = 0.0,
    ) -> ClosedChain:
        content = scenario.model_dump(mode="json", include={"arms", "object", "grasps"})
        factors = arm_mass, object_mass, joint_friction, hidden_mass
        key = json.dumps([content, factors, str(scenario.source)], sort_keys=True)
        if key not in self._chains:
            while len(self._chains) >= _KEPT:
                self._chains.popitem(last=False)
            self._chains[key] = build_chain(scenario, *factors)
        self._chains.move_to_end(key)
        return self._chains[key]

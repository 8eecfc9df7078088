"""A second, independent judge: Drake, with its own dynamics, contacts and closed loops.

Nothing of the toolkit's dynamics is used here: the URDFs are read by Drake's own parser.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from osc_contact.contacts.pairs import ContactPair
from osc_contact.dynamics.closed_chain import ClosedChain
from osc_contact.errors import PlantError, missing
from osc_contact.interface import Measurement
from osc_contact.lab.plants.drake_scene import scene
from osc_contact.lab.plants.faces import Faces
from osc_contact.lab.plants.noted_wrenches import NotedWrenches
from osc_contact.lab.scenarios.hardware import PlantSpec
from osc_contact.loop.judge import Truth, require_duration
from osc_contact.spatial import Array, as_array, cross


class DrakePlant:
    """Arms, object and environment in Drake (needs the extra `drake`).

    Attributes:
        chain: the true arms.
        contacts: contact pairs.
        faces: bodies of the environment, at rest.
        scene: parts of Drake's model.
        time: time since the last reset (s).
    """

    def __init__(
        self,
        chain: ClosedChain,
        arm_urdfs: Sequence[Path],
        object_urdf: Path,
        contacts: Sequence[ContactPair],
        bodies: Sequence[tuple[Path, pin.SE3]],
        *,
        options: PlantSpec,
        on: Sequence[int] | None = None,
    ) -> None:
        """Make the scene.

        Args:
            chain: the true arms and grasps, with names, frames, poses, rotors and damping.
            arm_urdfs: one file for each arm.
            object_urdf: file of the held object.
            contacts: pairs in whose magnitudes true forces are expressed; contact itself is
                determined by the collision geometry.
            bodies: URDF and pose in the world of each body of the environment, at rest.
            options: step, friction and Drake's own options.
            on: the body of each contact; default: each has its own.

        Raises:
            PlantError: Drake is missing, or the scene has a part that this plant does not model.
        """
        try:
            import pydrake.common
            import pydrake.systems.analysis as analysis
        except ImportError as error:
            raise PlantError(missing(error)) from error
        pydrake.common.configure_logging()
        self.chain = chain
        self.contacts = tuple(contacts)
        self.faces = Faces(None, on, len(contacts))
        try:
            self.scene = scene(
                chain, arm_urdfs, object_urdf, contacts, bodies, self.faces.on, options
            )
        except RuntimeError as error:
            raise PlantError(f"Drake refuses the scene: {error}") from error
        self._step = options.step  #: time step (s)
        plant = self.scene.plant
        # indices of the chain's joints in Drake's state vectors
        #: (n,) indices of the joint positions
        self._q = np.array([joint.position_start() for joint in self.scene.joints])
        #: (n,) indices of the joint velocities
        self._v = np.array([joint.velocity_start() for joint in self.scene.joints])
        self._torque_port = plant.get_actuation_input_port()  #: input port of the motor torques
        #: output port of the reactions at the joints
        self._reaction_port = plant.get_reaction_forces_output_port()
        self._simulator = analysis.Simulator(self.scene.diagram)  #: Drake's simulator of the scene
        self._root_context = self._simulator.get_mutable_context()  #: state of the simulation
        self.context: Any = plant.GetMyMutableContextFromRoot(self._root_context)
        self._tau = np.zeros(chain.n_a)  #: (n_a,) torques that act (N m, N)
        self._steps = 0  #: number of steps so far
        self.time = 0.0

    def reset(self, q: Array) -> None:
        """Start at rest at joint positions q (n,) at which loops are closed and contacts touch."""
        q = as_array("q", q, (self.chain.nq,))
        plant = self.scene.plant
        self.scene.diagram.SetDefaultContext(self._root_context)
        positions = plant.GetPositions(self.context)
        positions[self._q] = q
        plant.SetPositions(self.context, positions)
        plant.SetVelocities(self.context, np.zeros(plant.num_velocities()))
        self._root_context.SetTime(0.0)
        self._steps = 0
        self.time = 0.0
        self.hold(np.zeros(self.chain.n_a))
        self._simulator.Initialize()

    def hold(self, tau: Array) -> None:
        """Apply torques tau (n_a,) from now on without letting time pass (N m, N)."""
        self._tau = as_array("tau", tau, (self.chain.n_a,))
        self._torque_port.FixValue(self.context, self._tau)

    def measure(self) -> Measurement:
        """Read encoders, and the wrist wrenches under the torques applied last."""
        plant = self.scene.plant
        wrenches = np.zeros((len(self.chain.arms), 6))
        reactions = self._reaction_port.Eval(self.context)
        for i, cut in enumerate(self.scene.cuts):
            if cut is not None:
                wrenches[i, :3] = reactions[cut].translational()
                wrenches[i, 3:] = reactions[cut].rotational()
        q = plant.GetPositions(self.context)[self._q]
        v = plant.GetVelocities(self.context)[self._v]
        return Measurement(q, v, wrenches, None, self._tau.copy())

    def command(self, tau: Array, duration: float) -> None:
        """Hold torques for a control period.

        Args:
            tau: (n_a,) motor torques (N m, N).
            duration: period (s), rounded to whole steps.

        Raises:
            PlantError: Drake's solver fails, or the simulation diverges.
        """
        require_duration(duration)
        self.hold(tau)
        self._steps += round(duration / self._step) or 1
        self.time = self._steps * self._step
        try:
            # Drake makes the step at a time when it leaves it: half a step before is unambiguous
            self._simulator.AdvanceTo((self._steps - 0.5) * self._step)
        except RuntimeError as error:
            raise PlantError(f"Drake fails at t = {self.time:.4f} s: {error}") from error
        largest = np.abs(self.scene.plant.GetVelocities(self.context)).max()
        if not largest < 1e3:  # m/s, rad/s, far above all speeds of a task; true for NaN, too
            raise PlantError(
                f"Drake diverged at t = {self.time:.4f} s; largest speed {largest:.3g}. Lower the "
                "gains or the plant step."
            )

    def stop(self, reason: str = "") -> None:
        """Accept a stop; a simulation needs no action."""

    def truth(self) -> Truth:
        """True state at present, with contact forces under the torques applied last."""
        log = self.log()
        log.note()
        return log.truths(log.noted())[0]

    def poses(self) -> Array:
        """True poses (1 + arms, 4, 4) of the object and of the tips."""
        bodies = (self.scene.held, *self.scene.tips)
        return np.array([body.EvalPoseInWorld(self.context).GetAsMatrix4() for body in bodies])

    def log(self) -> DrakeTruth:
        """New, empty record of the truth."""
        return DrakeTruth(self)


class DrakeTruth(NotedWrenches):
    """Record of poses, twists and normal contact forces at present, under the torques applied."""

    def __init__(self, plant: DrakePlant) -> None:
        """Set the plant whose states are recorded."""
        inertia = plant.chain.reference_inertia(pin.SE3.Identity())
        super().__init__(plant.contacts, plant.faces, inertia)
        self._plant = plant  #: plant whose truth is recorded
        #: output port of the contact forces
        self._contact_port = plant.scene.plant.get_contact_results_output_port()
        self._rows: list[Array] = []  #: rows of numbers, one for each instant

    def note(self) -> None:
        """Append a row with the present state of the object, and the wrenches of its contacts.

        It has the rotation matrix and position (m) of the object, its twist (m/s, rad/s) at its
        origin, for each body of the environment the wrench (6) of normal forces on it at the
        object's origin (N, N m), and 1 for each body that is touched; all in world axes.
        """
        scene, context = self._plant.scene, self._plant.context
        X = scene.held.EvalPoseInWorld(context)
        V = scene.held.EvalSpatialVelocityInWorld(context)
        wrenches = np.zeros((len(self._plant.faces.rails), 6))
        touched = np.zeros(len(wrenches))
        for body, point, normal, force, moment in self._present_contacts():
            f = normal * (normal @ force)
            # friction of a flat area has its moment along the normal
            m = moment - normal * (normal @ moment)
            wrenches[body] += np.concatenate((f, m + cross(point - X.translation(), f)))
            touched[body] = 1.0
        R = X.rotation().matrix()
        parts = (R, X.translation(), V.translational(), V.rotational(), wrenches, touched)
        self._rows.append(np.concatenate(parts, axis=None))

    def _present_contacts(self) -> list[tuple[int, Array, Array, Array, Array]]:
        """Contacts of the present step: body, point, normal, force and moment on the body.

        Points (m), unit normals, forces (N) and moments at the point (N m) are in world axes.
        """
        results = self._contact_port.Eval(self._plant.context)
        found = []
        for i in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(i)
            pair = info.point_pair()
            # Drake gives the force on the second body of a pair of points
            body, sign = self._body_and_sign(pair.id_B, pair.id_A)
            force = sign * info.contact_force()
            found.append((body, info.contact_point(), pair.nhat_BA_W, force, np.zeros(3)))
        for i in range(results.num_hydroelastic_contacts()):
            info = results.hydroelastic_contact_info(i)
            area = info.contact_surface()
            # and that of a flat area on its first body
            body, sign = self._body_and_sign(area.id_M(), area.id_N())
            force = sign * info.F_Ac_W().translational()
            moment = sign * info.F_Ac_W().rotational()
            found.append((body, area.centroid(), area.face_normal(0), force, moment))
        return found

    def _body_and_sign(self, on: Any, other: Any) -> tuple[int, float]:
        """Index of the environment's body in a contact, and the sign of the force on it.

        Args:
            on: Drake's identifier of the shape on which the force is given.
            other: that of the other shape.
        """
        faces = self._plant.scene.faces
        body = faces.get(on.get_value())
        return (faces[other.get_value()], -1.0) if body is None else (body, 1.0)

    def noted(self, start: int = 0) -> Array:
        """Recorded rows (k, m) for `truths`.

        Args:
            start: index of the first row returned.
        """
        return np.array(self._rows[start:])

    def clear(self) -> None:
        """Delete the recorded rows."""
        self._rows.clear()

"""Contact pairs: the poses and twists of two bodies in, a Contact out (first-order geometry)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from osc_contact.contacts.contact import Contact
from osc_contact.errors import InvalidInputError
from osc_contact.spatial import Array, as_array, carry_twist, cross

__all__ = ["VertexOnFace"]


@dataclass(frozen=True)
class VertexOnFace:
    """A vertex of the held object on a face of the environment (each contact of fig. 1, r = 1).

    N = [n; (p − O) × n], n pointing into the face. n is fixed in the environment, p in the object:
    ṅ = ω_E × n, ṗ = v_O(p), so n_γ = −ṄᵀV_rel with Ṅ = [ṅ; ṗ × n + (p − O) × ṅ].

    A vertex rounded with a radius is a small sphere: its line of force passes through the centre,
    so `vertex` is that centre and only the gap knows the radius.

    Attributes:
        vertex: (3,) vertex, or centre of the rounded vertex, in the object frame (m).
        point: (3,) a point of the face in the environment frame (m).
        normal: (3,) outward normal of the face in the environment frame; normalised on entry.
        radius: of the rounded vertex (m).
        name: used in messages and recordings.
    """

    vertex: Array
    point: Array
    normal: Array
    radius: float = 0.0
    name: str = "vertex_on_face"
    _into: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for key in ("vertex", "point", "normal"):
            object.__setattr__(self, key, as_array(f"{self.name}.{key}", getattr(self, key), (3,)))
        length = float(np.linalg.norm(self.normal))
        if length < 1e-9:
            raise InvalidInputError(f"{self.name}.normal is zero; give the outward normal")
        if not (np.isfinite(self.radius) and self.radius >= 0.0):
            raise InvalidInputError(f"{self.name}.radius = {self.radius}; give a length ≥ 0 m")
        object.__setattr__(self, "normal", self.normal / length)
        object.__setattr__(self, "_into", -self.normal)

    def contact(
        self,
        X_WO: pin.SE3,
        V_O: Array,
        X_WE: pin.SE3 | None = None,
        V_E: Array | None = None,
    ) -> Contact:
        """N (6, 1) and n_γ (1,) at O, world axes.

        Args:
            X_WO: pose of the object; its origin is the operational point.
            V_O: (6,) its twist at O, world axes (m/s, rad/s).
            X_WE: pose of the environment body (default: the world).
            V_E: (6,) its twist at its own origin, world axes (default: at rest). Without X_WE
                that origin is the world's.
        """
        n = self._into if X_WE is None else X_WE.rotation @ self._into
        p = X_WO.rotation @ self.vertex  # from O
        if V_E is None:
            V_env = np.zeros(6)
        else:
            origin = np.zeros(3) if X_WE is None else X_WE.translation
            V_env = carry_twist(V_E, origin, X_WO.translation)
        n_dot = cross(V_env[3:], n)
        p_dot = V_O[:3] + cross(V_O[3:], p)
        N = np.concatenate((n, cross(p, n)))
        N_dot = np.concatenate((n_dot, cross(p_dot, n) + cross(p, n_dot)))
        return Contact(N[:, None], [-N_dot @ (V_O - V_env)])

    def gap(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> float:
        """Distance between vertex surface and face (m), negative when they overlap."""
        normal, point = self._face(X_WE)
        return float(normal @ (X_WO.act(self.vertex) - point)) - self.radius

    def point_on_face(self, X_WO: pin.SE3, X_WE: pin.SE3 | None = None) -> Array:
        """(3,) where the line of force meets the face, world (m)."""
        normal, point = self._face(X_WE)
        p: Array = X_WO.act(self.vertex)
        on_face: Array = p - (normal @ (p - point)) * normal
        return on_face

    def direction(self, X_WE: pin.SE3 | None = None) -> Array:
        """(3,) unit vector into the face, world: the direction of a positive contact force."""
        return -self._face(X_WE)[0]

    def face_placement(self) -> pin.SE3:
        """Pose of the face's surface in the environment frame: z along the outward normal."""
        z = self.normal
        across = cross(np.array([0.0, 1.0, 0.0]), z)
        if np.linalg.norm(across) < 1e-3:
            across = cross(np.array([0.0, 0.0, 1.0]), z)
        x = across / np.linalg.norm(across)
        return pin.SE3(np.column_stack((x, cross(z, x), z)), self.point)

    def _face(self, X_WE: pin.SE3 | None) -> tuple[Array, Array]:
        if X_WE is None:
            return self.normal, self.point
        return X_WE.rotation @ self.normal, X_WE.act(self.point)

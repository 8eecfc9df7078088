"""A pair of one's own whose axes are a choice, and its kind: a plugin of pytest.

`python -m pytest -p scratch_pair -k ball_in_tube tests/…` runs the tests of all pairs on it.
"""

import numpy as np
import pinocchio as pin
from pair_kinds import kind, placed, two_lines

import osc_contact as osc
from osc_contact.contacts.pairs.keys import BodyDirection, BodyPoint, Point
from osc_contact.contacts.pairs.pair import triad
from osc_contact.contacts.pairs.points_on_planes import PointsOnPlanes


@osc.register_pair(forces=2)
class BallInTube(PointsOnPlanes):
    """A ball of the object in a tube of the environment without play, r = 2."""

    point: Point
    """the centre of the ball [x, y, z] in the object frame"""
    tube_point: BodyPoint
    """a point of the tube's axis [x, y, z] in the body frame"""
    tube_direction: BodyDirection
    """along the tube's axis [x, y, z] in the body frame"""
    name: str = "ball_in_tube"
    axes_are_chosen = True

    def _make(self) -> None:
        points = np.tile(self.point[:, None], 2)
        self._hold_points(points, triad(self.tube_direction)[:, :2], self.tube_point)


@kind
def ball_in_tube(rng, c):
    centre, _, point, along = two_lines(rng)
    pair = BallInTube(c.A(centre), c.E(point), c.along_E(along))
    return (pair, lambda q: placed(pin.exp3(q[:3]), centre, point + q[3] * along), 2)

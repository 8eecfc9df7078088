"""Public module of `check_robot`, which checks the driver of a robot."""

from osc_contact.loop.testing import check_robot

__all__ = ["check_robot"]

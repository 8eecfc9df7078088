"""Estimates from readings of sensors and cameras: velocities, poses of bodies, wrist loads."""

"""The control loop on a robot: checks before the start, ticks, recording, shadow mode."""

"""Inertia and motion: one arm, the held object, the closed chain they form, the environment."""

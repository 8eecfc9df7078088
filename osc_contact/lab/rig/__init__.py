"""A scenario as objects: arms, faces, references, sensors, plant and controller."""

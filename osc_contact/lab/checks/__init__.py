"""Judgements of a rig before it runs, and of the forces and motions of its contacts."""

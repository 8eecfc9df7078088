"""Judgements of a rig before it runs, and of what its contacts transmit and permit."""

"""Experiments on top of the controller: scenarios, simulated rigs, runs, pictures, commands."""

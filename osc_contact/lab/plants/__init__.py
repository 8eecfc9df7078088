"""Simulated rigs that judge a controller; none of them imports the control package."""

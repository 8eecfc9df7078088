"""Drivers of real robots for the `Robot` protocol; each needs its maker's client library."""

"""Real robots behind the `Robot` protocol; each driver needs its maker's client library."""

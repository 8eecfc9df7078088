"""Settings: physical quantities with their units, and the keys of gains, limits and phases."""

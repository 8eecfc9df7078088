"""Geometry of contact: which forces it transmits (N), which motions it permits (T)."""

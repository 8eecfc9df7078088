"""Benchmarks: cost of the tick by size, compared with a lower bound and with other software."""

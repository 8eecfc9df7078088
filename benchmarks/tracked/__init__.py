"""Benchmarks that `asv run` follows from commit to commit."""

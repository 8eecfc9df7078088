"""Recordings of runs, in memory and in files."""

from osc_contact.recorder.recording import Recording, column_names

__all__ = ["Recording", "column_names"]

"""Runs of a rig: the recording, its verdict, the tape of a controller without Python."""

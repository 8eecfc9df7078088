"""Scenarios: YAML files → frozen, checked objects; the packaged files are in `files/`."""

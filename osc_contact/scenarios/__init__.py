"""Scenarios: YAML files → frozen, checked objects; the packaged files are in `files/`.

Settings of controllers are declared here, too.
"""

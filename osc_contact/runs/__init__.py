"""From a scenario to a verdict: build the rig, run it, judge it, report it."""

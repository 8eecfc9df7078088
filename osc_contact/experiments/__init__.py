"""From a scenario to a verdict: build the rig, run it, judge it, draw the paper's figures."""

"""Packaged tasks that scenarios do not describe: worlds with plans."""

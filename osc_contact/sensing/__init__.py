"""From readings of sensors and cameras to what the controller receives."""

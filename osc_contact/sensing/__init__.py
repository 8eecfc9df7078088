"""From what sensors and cameras say to what the controller is told."""

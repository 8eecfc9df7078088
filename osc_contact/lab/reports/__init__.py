"""Tables, figures and scenes of a recording."""

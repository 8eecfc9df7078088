"""Learning in contact: a bar wears a table's edge, whose hardness is hidden, evenly."""

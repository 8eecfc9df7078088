"""What the tick costs beside its peers, by size, on the clock, and in a whole run."""

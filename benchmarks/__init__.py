"""What the tick costs beside its floor and its peers, by size, on the clock, and in a whole run."""

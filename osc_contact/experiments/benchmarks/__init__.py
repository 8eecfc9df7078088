"""What the tick costs: against its floor, its peers, its size, the clock, and in a whole run.

Every module has `measure`, `tables` and `draw`: JSON-able numbers, what is printed, what is drawn.
"""

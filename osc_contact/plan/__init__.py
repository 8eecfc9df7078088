"""Plans: sequences of contact states with their forces, motions and conditions.

`motions` and `ends` have the words of a stage: what it commands, and what ends it.
"""

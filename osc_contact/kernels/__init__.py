"""The control tick compiled: arrays in, torques out, in place.

The files mirror the modules whose work they do; `control.compiled` packs the arrays. Everything
6-dimensional is written in *white* coordinates of the held object: twists x̃ = Lᵀx and wrenches
f̃ = L⁻¹f with Λ_o = LLᵀ, L from the object's principal axes at its centre of mass. There its
inertia is the identity, its weight and velocity products are trivial, and no rank decision depends
on units.
"""

"""The control law as array functions, fig. 4 from measurement to torques.

    rows(MODEL, MEMORY, WORK, INPUT) → MEMORY, WORK

Nothing else is read or written. `records` declares what they hold; `tick` runs the stages in the
order of the figure. The same source runs compiled, as plain Python, and over the rows of a batch.

Everything 6-dimensional is written in *energy coordinates* of the held object: motions x̃ = Lᵀx and
wrenches f̃ = L⁻¹f with Λ_o = LLᵀ, L from the object's principal axes at its centre of mass. There
the object's inertia is the identity, and no rank decision depends on units, frame or origin.
"""

"""Control law of fig. 4, from measurement to motor torques, as functions of arrays.

    rows(MODEL, MEMORY, WORK, INPUT) → MEMORY, WORK

The law reads and writes these four records only. `records` declares their fields; `tick` runs the
stages in the order of the figure. The same source runs compiled, as plain Python, and over the rows
of a batch.

Vectors and matrices of the operational space are in *energy coordinates* of the held object:
motions x̃ = Lᵀx and wrenches f̃ = L⁻¹f with Λ_o = LLᵀ, where L follows from the object's principal
axes at its centre of mass. In these coordinates the object's inertia is the identity, and decisions
about ranks do not depend on units, frame or origin.
"""

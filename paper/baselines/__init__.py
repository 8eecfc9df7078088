"""Selection-matrix control laws beside ours: what a constraint frame cannot do (`compare`)."""

"""Many runs of one scenario with other numbers: studies, tables of results, environments."""

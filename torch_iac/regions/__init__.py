"""The regions of the sensorimotor space: tree, cuts, examples and errors."""

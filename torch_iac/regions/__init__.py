"""How the sensorimotor space is divided: the tree, its cuts, what each leaf remembers."""

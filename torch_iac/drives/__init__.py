"""What candidate actions are worth, and which is taken."""

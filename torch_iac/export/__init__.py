"""Runs for other programs: the Rerun viewer, Minari's data sets."""

"""Gymnasium environments: making, bounds, vectors and saving."""

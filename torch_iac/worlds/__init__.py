"""Worlds of Gymnasium: made, bounded, vectorised and saved."""

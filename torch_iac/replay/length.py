"""The default length of a film's stages."""

N_DECISIONS = 20
"""Decisions in a stage of a film, by default."""

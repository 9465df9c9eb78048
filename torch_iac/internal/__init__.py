"""Shared tools: state, random numbers, scaling, checks, files."""

"""Tools that all rooms use: state, randomness, scaling, checks, files."""

"""Films of recorded decisions."""

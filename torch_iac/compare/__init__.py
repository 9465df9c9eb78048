"""Many runs: planned, carried out, compared and reported."""

"""What predicts in each region: nearest neighbours and networks."""

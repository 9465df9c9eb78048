"""What a run shows: regions over time, figures, maps, intervals, generalisation."""

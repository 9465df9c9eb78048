"""Comparisons of many runs: plan, execution, statistics and report."""

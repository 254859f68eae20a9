"""How often intervals, tests, indices and clusters are right, by simulated policies."""

QUICK = ("coverage", "sensitivity_coverage", "clusters_found")
"""What `--measure` measures: all."""

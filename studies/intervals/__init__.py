"""How often intervals, tests, indices and clusters are right, by simulated policies."""

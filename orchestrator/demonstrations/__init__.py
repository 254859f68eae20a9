"""Records the oracle's successes as datasets."""

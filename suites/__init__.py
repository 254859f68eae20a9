"""What to evaluate: suite files, conditions, protocols and the identity of an episode."""

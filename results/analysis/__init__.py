"""Tables, comparisons, leaderboards and robustness, computed from rows."""

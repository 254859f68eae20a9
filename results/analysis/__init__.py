"""From rows to tables, comparisons, leaderboards and robustness."""

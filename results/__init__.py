"""What came out: the record of an episode, the store, statistics, tables and reports."""

"""Results of others as runs: one file per format that is read, and `run.py`, which makes their rows."""

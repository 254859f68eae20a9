"""`robogauntlet list`: list what can be named in a suite, runs, and the episodes of a run."""

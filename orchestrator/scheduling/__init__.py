"""Which worker plays which episodes next, and the pool of Ray workers."""

"""The verbs of MergeVLA: train, merge and evaluate its routers."""

"""MergeVLA's experts and merged models as policies."""

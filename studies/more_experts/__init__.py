"""Merging and routing up to twenty experts of Meta-World."""

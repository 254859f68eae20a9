"""Experts of LIBERO's four suites, and MergeVLA's table at a small size."""

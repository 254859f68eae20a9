"""Experts of the SO-101, and merges of them."""

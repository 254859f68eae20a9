"""Experts of varied scenes, and what merging costs under shift."""

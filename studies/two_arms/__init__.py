"""Experts of tasks with two arms, and merges of them."""

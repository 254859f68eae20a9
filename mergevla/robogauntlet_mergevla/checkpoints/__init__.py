"""Checkpoints of experts and merged models: metadata, weights, reading and writing."""

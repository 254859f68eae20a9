"""Checkpoints that others released, read into ours."""

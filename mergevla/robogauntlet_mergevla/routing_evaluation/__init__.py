"""Evaluates the routers of a merged checkpoint on first observations."""

"""Runs on a Ray cluster whose nodes are network namespaces of this machine."""

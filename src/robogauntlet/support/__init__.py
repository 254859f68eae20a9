"""Helpers that any package may import: errors, files, child processes. No simulator, no torch, no Ray."""

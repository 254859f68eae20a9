"""Runs of the command line under random faults, see `python -m tests.chaos --help`."""

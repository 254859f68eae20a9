"""Runs of the command line under faults that are drawn at random: see `python -m tests.chaos --help`."""

"""Scheduled runs: their times, their outcomes and the process that starts them."""

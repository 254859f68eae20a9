"""Suites that are run at given times, compared with the run before, and reported on."""

"""Runs suites: rollouts, Ray workers, the scheduler and the command line."""

"""Runs that begin by themselves: what is to run when, what became of it, and the process that sees to it."""

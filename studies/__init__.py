"""Benchmarks: `make bench`. Each compares within one run, prints a table and writes `runs/bench/NAME.json`."""

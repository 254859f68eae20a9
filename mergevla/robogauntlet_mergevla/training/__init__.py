"""Training: demonstrations in, checkpoints out. Reads data sets and never drives a simulator."""

"""LeRobot checkpoints, computed by LeRobot itself in a Python environment that contains it."""

"""Checkpoints of LeRobot as a kind of policy, computed by LeRobot itself in an environment that holds it."""

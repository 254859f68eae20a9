"""Running from Python: evaluate a policy, open a task as a gymnasium environment."""

"""`robogauntlet search`: find what breaks a policy, or the checkpoint that became worse."""

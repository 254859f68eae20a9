"""`robogauntlet check`: check what is installed, an adapter, or a policy."""

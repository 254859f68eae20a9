"""Running from Python."""

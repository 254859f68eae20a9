"""What a slow policy costs on a robot that does not wait."""

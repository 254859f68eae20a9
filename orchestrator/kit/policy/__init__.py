"""The check of a policy: short episodes, and findings about its numbers."""

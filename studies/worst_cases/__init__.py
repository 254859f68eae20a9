"""The smallest disturbances that break a policy: what the search finds."""

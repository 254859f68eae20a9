"""Playing episodes: rollout, runner, leases, recorders."""

"""Runs suites: rollouts, Ray workers, the scheduler, the command line and the dashboard."""

if __name__ != "robogauntlet.orchestrator":  # under a second name, each class would exist twice
    raise ImportError(f"'{__name__}' is RoboGauntlet's own folder; import robogauntlet.orchestrator", name=__name__)

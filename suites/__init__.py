"""What to evaluate: suite files, perturbation axes and the identity of an episode."""

if __name__ != "robogauntlet.suites":  # under a second name, each class would exist twice
    raise ImportError(f"'{__name__}' is RoboGauntlet's own folder; import robogauntlet.suites", name=__name__)

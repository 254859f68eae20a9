"""Records of episodes, the store, statistics, analysis and reports."""

if __name__ != "robogauntlet.results":  # under a second name, each class would exist twice
    raise ImportError(f"'{__name__}' is RoboGauntlet's own folder; import robogauntlet.results", name=__name__)

"""Policies behind one contract: baselines, scripted oracles, MergeVLA, policy servers and LeRobot checkpoints."""

if __name__ != "robogauntlet.policies":  # under a second name, each class would exist twice
    raise ImportError(f"'{__name__}' is RoboGauntlet's own folder; import robogauntlet.policies", name=__name__)

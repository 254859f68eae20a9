"""Simulators behind one contract, a package each."""

if __name__ != "robogauntlet.adapters":  # under a second name, each class would exist twice
    raise ImportError(f"'{__name__}' is RoboGauntlet's own folder; import robogauntlet.adapters", name=__name__)

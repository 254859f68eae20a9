"""Tasks of the shipped zoo."""

WITH_EXPERTS = frozenset(
    {
        *(f"maniskill/{name}-v1" for name in ("PushCube", "PullCube", "StackCube")),
        *(f"pybullet/{name}-v3" for name in ("PandaReach", "PandaPush", "PandaPickAndPlace")),
        *(f"robosuite/{name}" for name in ("Lift", "Stack", "Door")),
    }
)
"""Tasks for which an expert was trained and a demonstration recorded."""

"""The former place of the plug-in, for environments whose installation still names it."""

from robogauntlet.orchestrator.kit.pytest_plugin import robogauntlet_checker  # noqa: F401

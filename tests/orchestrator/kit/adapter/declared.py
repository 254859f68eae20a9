"""The targets of the variants' entry points."""

from robogauntlet.orchestrator.kit.template.adapter.robogauntlet_toysim.oracle import Reach
from tests.orchestrator.kit.adapter import (  # noqa: F401  register them
    camera_variants,
    native_variants,
    object_variants,
    two_arm_variants,
)
from tests.orchestrator.kit.adapter.variants import VARIANTS


def __getattr__(name):
    if name.startswith("oracle_"):
        return {f"{name.removeprefix('oracle_')}/Reach": Reach}
    if name in VARIANTS:
        return VARIANTS[name]
    raise AttributeError(name)

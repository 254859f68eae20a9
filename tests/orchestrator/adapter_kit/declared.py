"""The targets of the variants' entry points."""

from robogauntlet.orchestrator.adapter_kit.scaffold.template.robogauntlet_toysim.oracle import Reach
from tests.orchestrator.adapter_kit import camera_variants, object_variants, two_arm_variants  # noqa: F401  register them
from tests.orchestrator.adapter_kit.variants import VARIANTS


def __getattr__(name):
    if name.startswith("oracle_"):
        return {f"{name.removeprefix('oracle_')}/Reach": Reach}
    if name in VARIANTS:
        return VARIANTS[name]
    raise AttributeError(name)

"""Declares the variants like entry points of packages, in this process and its child processes."""

import importlib
import os

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.kit.adapter.checked_task import VIEW, CheckedTask
from robogauntlet.policies import oracles
from robogauntlet.policies.oracles.plugins import load_oracles
from tests.orchestrator.kit.adapter import (  # noqa: F401  register them
    camera_variants,
    native_variants,
    object_variants,
    two_arm_variants,
)
from tests.orchestrator.kit.adapter.variants import VARIANTS


@pytest.fixture(scope="package", autouse=True)
def declared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("declared")
    info = folder / "variants-0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: variants\nVersion: 0\n")
    lines = []
    for group, prefix in (("simulators", ""), ("oracles", "oracle_")):
        lines += [f"[robogauntlet.{group}]"]
        lines += [f"{name} = tests.orchestrator.kit.adapter.declared:{prefix}{name}" for name in VARIANTS]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        patch.setenv("PYTHONPATH", os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]))
        importlib.invalidate_caches()
        _forget()
        yield
    _forget()


def _forget():
    for cached in (catalog._load, load_oracles, oracles.scripts):
        cached.cache_clear()


@pytest.fixture
def subject():
    """Opens the task of a variant in this process."""
    opened = []

    def open_variant(name, view=VIEW):
        opened.append(CheckedTask(VARIANTS[name], "Reach", view))
        return opened[-1]

    yield open_variant
    for task in opened:
        task.close()

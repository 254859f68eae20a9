"""Declares the toy and the liars as if packages had brought them, to this process and to those that it starts."""

import importlib
import os

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.adapter_kit.checks.checked_task import VIEW, CheckedTask
from robogauntlet.policies import oracles
from robogauntlet.policies.oracles.plugins import load_oracles
from tests.orchestrator.adapter_kit import camera_liars, object_liars  # noqa: F401  register them
from tests.orchestrator.adapter_kit.liars import LIARS


@pytest.fixture(scope="package", autouse=True)
def declared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("declared")
    info = folder / "liars-0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: liars\nVersion: 0\n")
    lines = [
        "[robogauntlet.simulators]",
        *(f"{name} = tests.orchestrator.adapter_kit.declared:{name}" for name in LIARS),
    ]
    lines += [
        "[robogauntlet.oracles]",
        *(f"{name} = tests.orchestrator.adapter_kit.declared:oracle_{name}" for name in LIARS),
    ]
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
    """The task of a liar, opened in this process."""
    opened = []

    def open_one(name, view=VIEW):
        opened.append(CheckedTask(LIARS[name], "Reach", view))
        return opened[-1]

    yield open_one
    for one in opened:
        one.close()

"""Experts and the command line, which the tests share."""

import pytest

from tests.mergevla.experts import save_experts
from tests.orchestrator.conftest import ray_here  # noqa: F401


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """Folders of three experts of one base. No test changes them."""
    return save_experts(tmp_path_factory.mktemp("zoo"))

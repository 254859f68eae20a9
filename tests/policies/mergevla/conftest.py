"""Experts that the tests share."""

import pytest

from tests.policies.mergevla.experts import save_experts


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """Folders of three experts of one base. No test changes them."""
    return save_experts(tmp_path_factory.mktemp("zoo"))

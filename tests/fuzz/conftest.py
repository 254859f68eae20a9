"""A bound of the memory that parsers may take, and a folder for their files."""

import resource
from pathlib import Path

import pytest

ROOM = 3 * 2**30
"""Address space that a test may add to what the process has (bytes)."""


@pytest.fixture(autouse=True)
def _bounded_memory():
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + ROOM, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@pytest.fixture(scope="session")
def good_files(tmp_path_factory):
    """Runs, an exported run, experts and a dataset, as for the tests of bad input."""
    from tests.bad_input.folder import fill

    folder = tmp_path_factory.mktemp("fuzz")
    fill(folder)
    return folder

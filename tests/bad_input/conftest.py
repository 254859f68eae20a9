"""The folder that bad inputs are typed in."""

import sys

import pytest

from robogauntlet.orchestrator.cli import main
from tests.bad_input import folder


@pytest.fixture(scope="session")
def good_files(tmp_path_factory):
    """The folder with the files of `folder.fill`, and what it holds."""
    place = tmp_path_factory.mktemp("bad-input") / "files"
    place.mkdir()
    folder.fill(place)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setattr(sys, "argv", ["robogauntlet", "list", "runs"])  # later commands find its tables, and the runs
        with pytest.raises(SystemExit):
            main()
    return place, folder.content(place)

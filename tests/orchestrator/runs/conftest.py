"""Files of suites, and runs of them."""

import pytest

from tests.orchestrator.runs.playing import SUITE, Run, play
from tests.results.synthetic import copied_run


@pytest.fixture
def suite_file(tmp_path):
    """Writes a suite, with further keys, into a new file."""

    def write(text, **more):
        path = tmp_path / f"suite-{len(list(tmp_path.iterdir()))}.yaml"
        path.write_text(text + "".join(f"{key}: {value}\n" for key, value in more.items()))
        return path

    return write


@pytest.fixture
def suite(suite_file):
    return lambda text=SUITE, **more: suite_file(text, **more)


@pytest.fixture
def run(tmp_path):
    return Run(tmp_path / "run")


@pytest.fixture(scope="module")
def finished_folder(tmp_path_factory, ray_here):
    folder = tmp_path_factory.mktemp("finished")
    (folder / "suite.yaml").write_text(SUITE)
    play(folder / "suite.yaml", folder / "run")
    return folder / "run"


@pytest.fixture
def finished(run, finished_folder):
    """A run whose folder holds a finished run of the suite."""
    copied_run(finished_folder, run.folder)
    return run

"""What a policy server says of itself: nothing, as openpi's, or what tells two checkpoints of one identity apart."""

import numpy as np
import pytest

from robogauntlet.orchestrator.runs.plan import make_plan
from robogauntlet.orchestrator.runs.run_document import create_or_continue
from robogauntlet.orchestrator.runs.suite_names import PlanError
from robogauntlet.results.run_document import read_run, write_run
from tests.errors import one_line_error
from tests.remote_servers import answering, speaking

CHUNK = {"actions": np.zeros((10, 7))}
SUITE = (
    "name: s\npolicies: [{{name: pi0, kind: openpi, options: {options}}}]\ntasks: [null/Reach]\nseeds: {{count: 1}}\n"
)
WARNING = (
    "as its server says nothing of itself, so that checkpoints behind it cannot be told apart; give option identity"
)


@pytest.fixture
def openpis():
    """A server that says nothing of itself, as openpi's."""
    with speaking(answering(CHUNK, metadata={})) as address:
        yield address


@pytest.mark.parametrize(
    "options", ["", "--option image_size=224", "--option image_size=224 --option translation_scale=0.01"]
)
def test_a_check_asks_for_no_identity(run_command, openpis, tmp_path, options):
    place = ("--task", "null/Reach", "--picture", str(tmp_path / "check.png"))
    done = run_command("check", "policy", openpis.replace("ws:", "openpi:"), *options.split(), *place)
    assert done.code == 0, done.err
    assert "identity" not in done.out + done.err


@pytest.mark.parametrize(
    "line",
    [
        "suite.yaml",
        "libero-spatial --option convention=libero --option image_size=224",
        "libero-openvla --option convention=libero --option image_size=224 --option execute=5",
        "libero-plus-robot --option convention=libero --option image_size=224",
        "robustness-smoke",
    ],
)
def test_every_line_of_the_manual_is_planned_and_says_that_checkpoints_cannot_be_told_apart(
    run_command, openpis, tmp_path, line
):
    (tmp_path / "suite.yaml").write_text("name: s\nneeds: policy\ntasks: [null/Reach]\nseeds: {count: 1}\n")
    done = run_command("plan", "--start", *line.split(), "--policy", openpis.replace("ws:", "openpi:"))
    assert done.code == 0, done.err
    assert WARNING in done.err
    assert "unknown" not in done.out.splitlines()[-1]


def test_a_suite_with_an_identity_is_warned_of_nothing(suite_file, openpis):
    options = f"{{address: '{openpis}', identity: pi0@1}}"
    assert make_plan(suite_file(SUITE.format(options=options))).warnings == ()


def test_a_run_is_not_continued_with_other_metadata_under_one_identity(suite_file, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()

    def planned(checkpoint):
        with speaking(answering(CHUNK, metadata={"checkpoint": checkpoint})) as address:
            path = suite_file(SUITE.format(options=f"{{address: '{address}', identity: pi0@1}}"))
            return make_plan(path)

    write_run(folder, create_or_continue(planned("a"), folder, None))
    write_run(folder, create_or_continue(planned("a"), folder, None))
    with one_line_error(
        PlanError, "the server of policy 'pi0' sends other metadata than when the run began, under the"
    ):
        create_or_continue(planned("b"), folder, None)
    assert list(read_run(folder).server_metadata) == ["pi0"]

"""`robogauntlet mergevla routing`: its output, its files and its errors."""

import json
from io import StringIO

import pytest
from rich.console import Console
from typer.testing import CliRunner

from robogauntlet.orchestrator.cli import app
from robogauntlet.suites.episode import View
from robogauntlet_mergevla.checkpoints.merged_checkpoint import save_merged
from robogauntlet_mergevla.cli.routing import STUDY, StudyProgress
from robogauntlet_mergevla.routing.catalog import NAMES, UNFITTED
from robogauntlet_mergevla.routing.observation_cache import file_of, load_observations
from robogauntlet_mergevla.routing_evaluation.first_observations import (
    FirstObservationError,
    collect_first_observations,
)
from tests.mergevla.experts import TASKS, merging, save_experts
from tests.mergevla.training.test_finetune import dataset

pytestmark = [pytest.mark.ray, pytest.mark.usefixtures("ray_here")]


@pytest.fixture(scope="module")
def zoo(tmp_path_factory, ray_here):
    """A merged checkpoint with fitted routers, one without, demonstrations, and kept observations of seeds 1 to 4."""
    folder = tmp_path_factory.mktemp("zoo")
    experts = save_experts(folder)
    for start, task in enumerate(TASKS):
        dataset(folder / "data", task.partition("/")[2], range(10 * start, 10 * start + 8), instruction=task)
    save_merged(folder / "plain", merging(experts, operator="ta"))
    arguments = [*map(str, experts), "--out", folder / "merged", "--demonstrations", folder / "data"]
    assert CliRunner().invoke(app, ["mergevla", "merge", *map(str, arguments)]).exit_code == 0
    done = study(folder / "merged", "--first-seed", 1, "--seeds", 4, "--keep", folder / "kept")
    assert done.exit_code == 0, done.exception
    return folder


def study(*arguments):
    return CliRunner().invoke(app, ["mergevla", "routing", *map(str, arguments)])


@pytest.fixture
def no_simulator(monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError("a simulator was started")

    monkeypatch.setattr("robogauntlet_mergevla.routing_evaluation.first_observations.run_per_simulator", refuse)


def test_every_router_is_shown_and_everything_is_written(zoo, tmp_path, no_simulator):
    done = study(
        *(zoo / "merged", "--first-seed", 2, "--seeds", 3, "--keep", zoo / "kept"),
        *("--demonstrations", zoo / "data", "--json", tmp_path / "found.json"),
    )
    assert done.exit_code == 0, done.exception
    for word in ("3 tasks, 3 seeds from 2", "one backbone pass", "calibrated, instruction hidden", *NAMES, *TASKS):
        assert word in done.output
    found = json.loads((tmp_path / "found.json").read_text())
    STUDY.check(tmp_path / "found.json")  # it may be replaced
    assert found["seeds"] == {"start": 2, "count": 3}
    assert found["tasks"] == list(TASKS)
    assert [(one["router"], one["sees_instruction"]) for one in found["routers"]] == [
        (name, sees) for name in NAMES for sees in (True, False)
    ]
    oracle = next(one for one in found["routers"] if one["router"] == "oracle")
    assert oracle["quality"]["accuracy"]["successes"] == oracle["quality"]["accuracy"]["trials"] == 9
    assert {one["router"] for one in found["unknown_tasks"]} == {"calibrated", "nearest-centroid"}
    assert found["unknown_tasks"][0]["by_task"].keys() == set(TASKS)


def test_the_same_episodes_are_seen_again(zoo, tmp_path):
    assert study(zoo / "plain", "--first-seed", 3, "--seeds", 1, "--keep", tmp_path).exit_code == 0
    for task in TASKS:
        kept, again = load_observations(file_of(zoo / "kept", task)), load_observations(file_of(tmp_path, task))
        assert kept.seeds == (1, 2, 3, 4)
        assert again.seeds == (3,)
        assert (again.images[0] == kept.images[2]).all()


def test_a_checkpoint_without_fitted_routers_is_evaluated_with_the_others(zoo, no_simulator):
    done = study(zoo / "plain", "--first-seed", 1, "--seeds", 1, "--keep", zoo / "kept")
    assert done.exit_code == 0, done.exception
    assert all(name in done.output for name in UNFITTED)
    assert "nearest-centroid" not in done.output
    assert "the checkpoint holds no fitted routers" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{zoo}/none"], "expected a checkpoint's folder or a hub id"),
        (["{zoo}/base"], "merged"),
        (["{zoo}/merged", "--keep", "{zoo}/merged/card.json"], "--keep: expected a folder, got the file"),
        (["{zoo}/merged", "--json", "{zoo}/none/x.json"], "x.json: expected a file in an existing folder"),
        (["{zoo}/merged", "--demonstrations", "{zoo}/data/Reach"], "got none of null/Slow"),
        (["{zoo}/merged", "--router", "paper-coded:rank=0"], "rank=1 or more, block=0 or more, got 'rank=0'"),
        (["zoo:libero-merged"], ": expected seeds 0 to 49, since it has 50 stored states, which further seeds repeat"),
        # The null simulator's task Raise raises at seed 7.
        (["{zoo}/merged", "--first-seed", "7", "--seeds", "1"], "null: RuntimeError: the null simulator was asked to"),
    ],
)
def test_a_mistake_is_one_line(run_command, arguments, message, zoo):
    assert message in run_command("mergevla", "routing", *(argument.format(zoo=zoo) for argument in arguments)).refusal


def test_a_hanging_simulator_is_abandoned(monkeypatch, tmp_path):
    monkeypatch.setattr("robogauntlet_mergevla.routing_evaluation.first_observations.SILENCE_S", 1.0)
    with pytest.raises(FirstObservationError, match="null: no result within 1 s"):
        collect_first_observations(["null/Hang"], View(image_size=16), [7], tmp_path, lambda *progress: None)


def test_a_simulator_that_crashes_is_named(tmp_path):
    with pytest.raises(FirstObservationError, match=r"null: .*died"):
        collect_first_observations(["null/Crash"], View(image_size=16), [7], tmp_path, lambda *progress: None)


def test_tasks_of_missing_simulators_are_refused(tmp_path):
    with pytest.raises(FirstObservationError, match="unknown simulator 'nul'"):
        collect_first_observations(["nul/Reach"], View(), [0], tmp_path, lambda *progress: None)


def test_progress_without_a_terminal_is_an_occasional_line():
    console = Console(file=StringIO(), width=80)
    clock = [0.0]
    with StudyProgress(console, now=lambda: clock[0]) as progress:
        for now, done in ((1.0, 0), (6.0, 10), (12.0, 20), (13.0, 30)):
            clock[0] = now
            progress.show("routing", done, 60)
    assert console.file.getvalue() == "routing: 20/60  22 s left\n"


def test_a_broken_cache_file_is_named(zoo, tmp_path):
    file_of(tmp_path, "null/Reach").write_text("no archive")
    done = study(zoo / "merged", "--keep", tmp_path)
    assert "null__Reach.npz: expected first observations of a task" in str(done.exception)

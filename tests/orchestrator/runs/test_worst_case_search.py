"""A search for worst cases plays its rounds as runs, tells what it found, and continues where it was interrupted."""

import json
import shutil
from contextlib import nullcontext
from dataclasses import replace

import pytest

from robogauntlet.adapters.catalog import task_descriptions
from robogauntlet.orchestrator.runs import worst_case_search
from robogauntlet.orchestrator.runs.worst_case_search import SearchRequest, SearchStopped, plan_search, play_search
from robogauntlet.policies.references import read_reference
from robogauntlet.results.report.worst_cases import boundary_table, confirmation_table, smallest_text
from robogauntlet.results.run_document import RunStatus, read_run
from robogauntlet.results.statistics.worst_case import LEAST_STATES
from robogauntlet.results.store.episode_store import Store
from robogauntlet.suites.episode import FIRST_TRAINING_SEED, SuccessRule
from robogauntlet.support.errors import BadInput
from tests.orchestrator.runs.playing import rows_of

BUDGET = 150


def request(**changes):
    chosen = {
        "policy": read_reference("oracle"),
        "tasks": ("null/Reach",),
        "axes": ("action-delay", "action-noise"),
        "budget": BUDGET,
        "below": 0.5,
        "seed": 0,
    }
    return SearchRequest(**{**chosen, **changes})


def play(folder, on_line=lambda line: None, **changes):
    asked = request(**changes)
    return play_search(asked, plan_search(asked), folder, on_line)


@pytest.fixture(scope="module")
def searched(tmp_path_factory, ray_here, room_for_one):
    """A search's folder, what it found, and its lines."""
    folder, lines = tmp_path_factory.mktemp("searched") / "search", []
    return folder, play(folder, lines.append), lines


@pytest.mark.ray
def test_the_axis_that_breaks_the_oracle_is_found_and_confirmed(searched):
    (found,) = searched[1]
    delay, noise = found.found.axes
    assert delay.breaks
    assert delay.is_confirmed
    assert 0.8 < delay.boundary.value < 2.2
    assert delay.found.trials >= 8
    assert not noise.breaks
    assert noise.point == (("action-noise", 5.0),)
    assert found.errors == 0
    assert "action-delay@" in smallest_text(found.found)


@pytest.mark.ray
def test_every_episode_is_stored_and_the_confirmation_has_seeds_of_its_own(searched):
    folder, (found,), lines = searched
    rounds = sorted((folder / "null-Reach").iterdir())
    assert len(rounds) == len(lines)
    assert "clean" in lines[0]
    rows = [rows_of(one) for one in rounds]
    assert sum(map(len, rows)) == found.found.episodes <= BUDGET
    confirming = {row.seed for one in rows for row in one if row.seed >= 10_000}
    assert len(confirming) == found.found.clean.trials
    assert max(confirming) < FIRST_TRAINING_SEED
    assert all(read_run(one).status is RunStatus.COMPLETE for one in rounds)


@pytest.mark.ray
def test_the_file_has_arguments_boundaries_and_physical_values(searched):
    content = json.loads((searched[0] / "search.json").read_text())
    assert content["status"] == "complete"
    assert content["budget"] == BUDGET
    (task,) = content["found"]
    delay = task["axes"][0]
    assert delay["boundary"]["physical"].endswith(" ms")
    assert delay["disturbance"] == f"action-delay@{delay['norm']:g}"
    assert delay["success"]["high"] < 0.5
    assert delay["confirmed"] is True


@pytest.mark.ray
def test_the_tables_have_a_column_per_task_and_a_line_per_disturbance(searched):
    (found,) = searched[1]
    cases = {"null/Reach": found.found, "null/Slow": found.found}
    boundaries = boundary_table(cases)
    assert boundaries.header == ("boundary, 80 % interval", "null/Reach", "null/Slow")
    assert [row[0] for row in boundaries.rows] == ["clean success", "action-delay", "action-noise", "combined"]
    assert boundaries.rows[2][1] == ">5"
    confirmation = confirmation_table(cases, 0.5)
    assert {row[0] for row in confirmation.rows} == set(cases)
    assert confirmation.rows[0][-1] == "breaks"


@pytest.fixture
def begun(searched, tmp_path):
    """The search as it was before its last two rounds."""
    folder = shutil.copytree(searched[0], tmp_path / "again")
    content = json.loads((folder / "search.json").read_text()) | {"status": "running"}
    (folder / "search.json").write_text(json.dumps({name: content[name] for name in content if name != "found"}))
    for later in sorted((folder / "null-Reach").iterdir())[-2:]:
        shutil.rmtree(later)
    return folder


@pytest.mark.ray
def test_an_interrupted_search_continues_and_finds_the_same(searched, begun, monkeypatch):
    def interrupt(self, rows):
        raise KeyboardInterrupt

    before = sorted((begun / "null-Reach").iterdir())
    first = read_run(before[0]).run_id, (before[0] / "episodes.sqlite").stat().st_mtime_ns
    with monkeypatch.context() as patched:
        patched.setattr(Store, "add", interrupt)
        with pytest.raises(KeyboardInterrupt):
            play(begun)
    assert json.loads((begun / "search.json").read_text())["status"] == "running"
    rounds = sorted((begun / "null-Reach").iterdir())
    assert len(rounds) == len(before) + 1
    assert read_run(rounds[-1]).status is RunStatus.INTERRUPTED
    assert play(begun) == searched[1]
    assert (read_run(before[0]).run_id, (before[0] / "episodes.sqlite").stat().st_mtime_ns) == first


@pytest.mark.ray
def test_a_complete_search_is_read_and_not_played_again(searched, tmp_path, monkeypatch):
    shutil.copytree(searched[0], tmp_path / "copy")
    monkeypatch.setattr(worst_case_search, "run_plan", None)
    assert play(tmp_path / "copy") == searched[1]


@pytest.mark.ray
@pytest.mark.parametrize(
    ("name", "value"),
    [("budget", 120), ("axes", ("action-delay",)), ("seed", 1), ("below", 0.4), ("success", SuccessRule.ONCE)],
)
def test_a_folder_with_another_search_is_refused(searched, name, value):
    with pytest.raises(BadInput, match=f"its search has another '{name}'; give another folder with --out"):
        play(searched[0], **{name: value})


@pytest.mark.nightly
@pytest.mark.ray
@pytest.mark.usefixtures("ray_here", "room_for_one")
def test_a_round_of_errors_alone_stops_the_search(tmp_path):
    with pytest.raises(SearchStopped, match="round-01: no episode was played; each ended in an error"):
        play(tmp_path / "broken", policy=read_reference(f"python:{__name__}:Broken"), axes=("noise",), budget=40)


@pytest.mark.parametrize("rule", SuccessRule)
def test_rounds_count_success_by_the_rule_of_the_search(tmp_path, monkeypatch, rule):
    def caught(plan, *rest):
        raise SearchStopped(plan.suite.success_rule)

    monkeypatch.setattr(worst_case_search, "_ray", nullcontext)
    monkeypatch.setattr(worst_case_search, "run_plan", caught)
    with pytest.raises(SearchStopped, match=f"^{rule}$"):
        play(tmp_path / "search", success=rule)


class Broken:
    """A policy that always fails to answer."""

    def __call__(self, images, proprioception, instruction):
        raise RuntimeError("broken")


def test_axes_that_a_task_cannot_have_are_skipped_with_the_reason():
    (search,) = plan_search(request(axes=(), tasks=("pybullet/PandaReach-v3",), budget=1000))
    assert search.skipped["dynamics"] == "the arm can move nothing in it"
    assert "dynamics" not in search.axes
    assert "blind" not in search.axes
    assert {"camera-orbit", "action-delay", "distractors"} <= set(search.axes)


def test_a_task_with_too_few_stored_states_is_not_searched(monkeypatch):
    known = {"null/Reach": task_descriptions()["null/Reach"]}
    for states in (LEAST_STATES, LEAST_STATES - 1):
        few = {**known, "null/Reach": replace(known["null/Reach"], start_states=states)}
        monkeypatch.setattr(worst_case_search, "task_descriptions", lambda few=few: few)
        if states == LEAST_STATES:
            assert plan_search(request())[0].start_states == states
        else:
            with pytest.raises(BadInput, match=r"^null/Reach: expected 40 stored states or more to search on some and"):
                plan_search(request())


def test_the_budget_is_shared_by_the_tasks():
    searches = plan_search(request(tasks=("null/Reach", "null/Slow"), budget=301))
    assert [one.budget for one in searches] == [150, 150]


COMMAND = (
    *("search", "disturbance", "--policy", "oracle", "--task", "null/Reach", "--budget", BUDGET),
    *("--axis", "action-delay", "--axis", "action-noise"),
)


@pytest.mark.ray
def test_the_command_prints_boundaries_the_confirmation_and_the_smallest_disturbance(searched, run_command):
    done = run_command(*COMMAND, "--out", searched[0])
    assert done.code == 0
    assert "null/Reach, round 1, axes alone: clean " in done.out
    assert "Broken: success below 50 % of the clean rate." in done.out
    assert "null/Reach: the smallest disturbance that is confirmed to break the policy is action-delay@" in done.out


@pytest.mark.ray
def test_json_is_alone_on_standard_output(searched, run_command):
    done = run_command(*COMMAND, "--out", searched[0], "--json")
    found = json.loads(done.out)
    assert found["below"] == 0.5
    assert found["found"] == json.loads((searched[0] / "search.json").read_text())["found"]
    assert "round 1" in done.err


@pytest.mark.ray
@pytest.mark.usefixtures("ray_here")
def test_an_interrupted_command_says_how_to_continue(run_command, monkeypatch):
    def interrupt(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(worst_case_search, "run_plan", interrupt)
    done = run_command(*COMMAND, "--out", "new")
    assert done.code == 130
    assert done.err.startswith(
        "robogauntlet: interrupted; continue with: robogauntlet search disturbance --policy oracle"
    )
    assert done.err.rstrip().endswith("--out new")

"""Suites that are composed of names."""

import pytest
import yaml

from robogauntlet.orchestrator.runs import composition
from robogauntlet.orchestrator.runs.composition import SUITE_FILE, compose_plan, new_run_folder
from robogauntlet.policies.references import read_reference
from robogauntlet.suites.axes import AXES
from robogauntlet.suites.episode import CAMERAS, RenderProfile
from robogauntlet.suites.registry import KnownTask, Registry
from robogauntlet.suites.schema import MAX_NAME, policy_entry
from robogauntlet.support.errors import BadInput
from tests.errors import one_line_error

ORACLE = [read_reference("oracle")]


def suite_of(tasks=("null/Reach",), **options):
    plan, folder = compose_plan(ORACLE, tasks, **options)
    assert not folder.exists()
    assert plan.path == folder / SUITE_FILE
    return plan.suite, yaml.safe_load(plan.text)


def test_the_suite_is_clean_with_twenty_seeds_by_default():
    suite, written = suite_of()
    assert (suite.seeds.count, [str(condition) for condition in suite.all_conditions()]) == (20, ["clean"])
    assert written["policies"] == [{"name": "oracle", "kind": "oracle"}]


def test_no_more_seeds_are_chosen_than_tasks_have_stored_states(monkeypatch):
    known = {"null/Reach": KnownTask(40), "null/Slow": KnownTask(40, start_states=7)}
    monkeypatch.setattr(composition, "load_registry", lambda: Registry(known, {}))
    assert [suite_of(tasks)[0].seeds.count for tasks in (["null/Reach"], ["null/Reach", "null/S*"])] == [20, 7]
    assert compose_plan(ORACLE, ["null/Slow"], most=200)[0].suite.seeds.count == 7


@pytest.mark.parametrize(
    ("conditions", "expected"),
    [
        (["clean"], ["clean"]),
        (["noise@2,4", "clean"], ["clean", "noise@2", "noise@4"]),
        (["noise@2,4"], ["clean", "noise@2", "noise@4"]),
        (["noise"], ["clean", *(f"noise@{number + 1}" for number in range(len(AXES["noise"].levels)))]),
        (["again"], ["clean", "again"]),
    ],
)
def test_a_condition_is_an_axis_with_some_or_all_severities_beside_clean(conditions, expected):
    suite, _ = suite_of(conditions=conditions)
    assert [str(condition) for condition in suite.all_conditions()] == expected


@pytest.mark.parametrize(
    ("tasks", "name"),
    [
        (["null/Reach"], "null-Reach"),
        (["null/Reach", "null/Slow"], "null-Reach-and-1-more"),
        (["null/[RS]*"], "null-RS"),
    ],
)
def test_the_suite_is_named_after_its_tasks(tasks, name):
    assert suite_of(tasks)[0].name == name


def test_the_cameras_are_those_that_all_tasks_have():
    assert suite_of(["null/Reach"])[0].cameras == CAMERAS
    suite, written = suite_of(["gymnasium/PandaReach-v3", "null/Reach"])
    assert suite.cameras == ("third_person",)
    assert written["cameras"] == ["third_person"]


def test_further_keys_are_those_of_a_suite():
    assert suite_of(settings={"image_size": 32, "cameras": ("wrist",)})[0].image_size == 32
    with one_line_error(BadInput, "unknown key 'imagesize'; did you mean 'image_size'?"):
        suite_of(settings={"imagesize": 32})
    with one_line_error(BadInput, "expected numbers, text, lists and mappings in a suite, got a object"):
        suite_of(settings={"image_size": object()})


def test_further_keys_do_not_replace_what_the_arguments_make():
    with one_line_error(BadInput, "policies: expected further keys of a suite"):
        suite_of(settings={"policies": ["random"]})


def test_policies_whose_long_names_begin_alike_keep_different_names():
    folder = "lerobot:" + "/deep" * 20
    first, second = (policy_entry(f"{folder}/{step}/pretrained_model") for step in ("010000", "020000"))
    assert first["name"] != second["name"]
    assert max(len(first["name"]), len(second["name"])) <= MAX_NAME


def test_another_suite_in_the_folder_of_a_new_run_is_kept_and_refused(run_command, tmp_path):
    mine = tmp_path / "suite.yaml"
    mine.write_text("name: mine\n")
    result = run_command("run", "--policy", "oracle", "--task", "null/Reach", "--seeds", "1", "--out", ".")
    assert "expected no other suite in the folder of a new run; choose another folder" in result.refusal
    assert mine.read_text() == "name: mine\n"
    assert not (tmp_path / "episodes.sqlite").exists()


def test_a_new_run_gets_a_new_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = new_run_folder("s")
    first.mkdir(parents=True)
    assert not new_run_folder("s").exists()


def test_settings_are_written_into_the_suite():
    suite, written = suite_of(settings={"image_size": 128, "render_profile": RenderProfile.FAST, "workers": 2})
    assert (suite.image_size, suite.render_profile, suite.workers) == (128, RenderProfile.FAST, 2)
    assert (written["image_size"], written["render_profile"], written["workers"]) == (128, "fast", 2)

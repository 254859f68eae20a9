"""LIBERO's adapter without LIBERO: names, assets, versions, files that are not trusted."""

import re
from collections import Counter
from fnmatch import fnmatch

import numpy as np
import pytest

from robogauntlet.adapters.contract import AdapterError, Goal, SimulatorUnavailable
from robogauntlet.adapters.libero import SIMULATOR, assets
from robogauntlet.adapters.libero.assets import LIBERO_PLUS, PARTS, STAND_INS, Assets, find_assets
from robogauntlet.adapters.libero.libero_import import Libero, check_versions
from robogauntlet.adapters.libero.tasks import HORIZONS, ON_OBJECT, libero_tasks
from robogauntlet.adapters.user_assets import content_hash, variable
from tests.errors import one_line_error

VARIABLE = variable("libero")


@pytest.fixture
def nowhere(monkeypatch, tmp_path):
    """A machine without anything of LIBERO."""
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("LIBERO_CONFIG_PATH", str(tmp_path / "no-configuration"))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(assets, "package_folder", lambda: None)
    monkeypatch.setattr(assets, "installed_folder", lambda: None)
    return tmp_path


def folder_of_assets(folder, *, stand_ins=False):
    for part in PARTS:
        (folder / part).mkdir(parents=True)
        (folder / part / "thing.xml").write_text(part)
    if stand_ins:
        (folder / STAND_INS).write_text("a bowl")
    return folder


def test_a_pattern_chooses_a_suite_or_the_task_of_a_number():
    counts = {suite: sum(fnmatch(task, f"{suite}-*") for task in SIMULATOR.tasks) for suite in HORIZONS}
    assert counts == {"spatial": 10, "object": 10, "goal": 10, "10": 10, "90": 90}
    assert [task for task in SIMULATOR.tasks if fnmatch(task, "goal-7-*")] == ["goal-7-turn-on-stove"]


def test_horizons_and_instructions_are_those_of_the_protocol():
    cards = SIMULATOR.tasks
    assert cards["spatial-3-on-cookie-box"].horizon == 220
    assert cards["10-8-kitchen8-put-both-moka-pots-on-stove"].horizon == 520
    assert cards["90-20-kitchen3-turn-on-stove"].instruction == "turn on the stove"


def test_a_task_says_what_cannot_be_adjusted_in_it():
    assert libero_tasks()["goal-7-turn-on-stove"].description.fixed.keys() == {"objects", "dynamics"}
    assert libero_tasks()["spatial-3-on-cookie-box"].description.fixed.keys() == {"objects"}
    assert libero_tasks()["object-0-alphabet-soup"].description.fixed.keys() == {"objects", "table"}
    assert not libero_tasks()["goal-8-put-bowl-on-plate"].description.fixed


def test_the_goal_of_a_task_is_that_its_object_comes_to_its_place():
    goals = {name: task.description.goal for name, task in libero_tasks().items()}
    assert goals["goal-8-put-bowl-on-plate"] == Goal(
        "akita_black_bowl_1_position", "goal_position", axes="xy", tolerance=ON_OBJECT, grasped=True
    )
    drawer = goals["90-02-kitchen10-put-black-bowl-in-top-drawer-cabinet"]
    pushed = goals["goal-5-push-plate-to-front-stove"]
    assert (drawer.axes, drawer.tolerance) == ("xyz", 0.08)
    assert (pushed.grasped, pushed.handle) == (False, "tcp_position")
    assert sum(goal is not None for name, goal in goals.items() if not name.startswith("pro-")) == 89


@pytest.mark.parametrize(
    "number",
    ["goal-7", "90-63", "10-3", "90-41", "goal-9"],
    ids=["fixture", "two-objects", "object-and-fixture", "frying-pan", "wine-bottle"],
)
def test_a_task_about_more_than_the_place_of_one_object_s_centre_has_no_goal(number):
    (task,) = (task for name, task in libero_tasks().items() if name.startswith(f"{number}-"))
    assert task.description.goal is None


@pytest.mark.parametrize("mujoco", ["3.4.0", "3.8.1", "4.0.0"])
def test_a_mujoco_under_which_stored_states_jump_is_refused(mujoco):
    message = f"needs mujoco below 3.4, found {mujoco}.*robogauntlet env create libero"
    with pytest.raises(SimulatorUnavailable, match=message):
        check_versions("1.4.0", mujoco)


def test_another_robosuite_is_refused():
    message = r"needs robosuite 1.4.0, found 1.5.2; .*robogauntlet env create libero"
    with pytest.raises(SimulatorUnavailable, match=message):
        check_versions("1.5.2", "3.3.7")


def test_missing_assets_are_one_line_with_what_to_do(nowhere):
    with one_line_error(SimulatorUnavailable) as caught:
        find_assets()
    message = str(caught.value)
    assert VARIABLE in message
    assert "robogauntlet env create libero" in message


def test_assets_are_found_where_the_variable_says(nowhere, monkeypatch):
    monkeypatch.setenv(VARIABLE, str(folder_of_assets(nowhere / "mine")))
    assert find_assets() == find_assets(LIBERO_PLUS) == Assets((nowhere / "mine").resolve(), False, of_user=True)
    monkeypatch.setenv(variable(LIBERO_PLUS), str(folder_of_assets(nowhere / "more")))
    assert [find_assets(name).folder.name for name in ("libero", LIBERO_PLUS)] == ["mine", "more"]


def test_assets_of_wheels_that_are_not_whole_are_refused(nowhere, monkeypatch):
    folder = folder_of_assets(nowhere / "wheels")
    monkeypatch.setattr(assets, "installed_folder", lambda: folder)
    with one_line_error(SimulatorUnavailable) as caught:
        find_assets()
    message = f"hash to 3368e0dd, found {Assets(folder, False).fingerprint()}; .*robogauntlet env create libero --fresh"
    assert re.search(message, str(caught.value))
    monkeypatch.setattr(assets, "FINGERPRINT", Assets(folder, False).fingerprint())
    assert find_assets().folder == folder.resolve()


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("elsewhere", "elsewhere does not exist"),
        ("config.yaml", "config.yaml is a file, expected a folder"),
        ("half", "half lacks scenes and 4 more"),
    ],
)
def test_a_variable_that_names_no_whole_folder_is_one_line(nowhere, monkeypatch, name, says):
    folder = folder_of_assets(nowhere / "wheels")
    monkeypatch.setattr(assets, "installed_folder", lambda: folder)
    (nowhere / "config.yaml").touch()
    (nowhere / "half" / PARTS[0]).mkdir(parents=True)
    monkeypatch.setenv(VARIABLE, str(nowhere / name))
    with one_line_error(SimulatorUnavailable) as caught:
        find_assets()
    assert f"{says} ({VARIABLE}); install them" in str(caught.value)


def test_assets_are_found_where_liberos_configuration_says(nowhere, monkeypatch):
    (nowhere / "config.yaml").write_text(f"assets: {folder_of_assets(nowhere / 'theirs')}")
    monkeypatch.setenv("LIBERO_CONFIG_PATH", str(nowhere))
    assert find_assets().folder == (nowhere / "theirs").resolve()


def test_stand_ins_are_named_and_another_file_is_another_hash(tmp_path):
    own = Assets(folder_of_assets(tmp_path / "own"), stand_ins=False)
    (tmp_path / "own" / "scenes" / "thing.xml").write_text("another")
    other = own.fingerprint()
    (tmp_path / "own" / "scenes" / "thing.xml").write_text("scenes")
    assert own.fingerprint() != other
    assert str(own) == f"LIBERO assets {own.fingerprint()} without stand-ins"
    of_user = Assets(own.folder, stand_ins=False, of_user=True)
    assert str(of_user) == f"LIBERO assets {content_hash(own.folder)} without stand-ins"
    assert "with stand-ins" in str(Assets(tmp_path, stand_ins=True))


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", None], ids=["empty", "damaged", "pickle"])
def test_stored_states_that_are_no_numbers_are_one_line(tmp_path, content):
    path = tmp_path / "init_files" / "libero_goal" / "open.pruned_init.npz"
    path.parent.mkdir(parents=True)
    path.write_bytes(content) if content is not None else np.savez(path, states=np.array([{}], dtype=object))
    package = Libero(tmp_path, None, None, {}, Assets(tmp_path, stand_ins=False))
    with one_line_error(AdapterError) as caught:
        package.stored_states("libero_goal", "open")
    assert f"{path}: expected LIBERO's stored states, an array of numbers; " in str(caught.value)


def test_a_task_of_liberopro_says_what_its_definition_says_and_what_others_send():
    card = SIMULATOR.tasks["pro-task-goal-7-turn-on-stove"]
    assert (card.instruction, card.published_instruction) == ("turn off the stove", "turn on the stove")
    assert (card.variant_of, card.horizon, card.start_states) == ("libero/goal-7-turn-on-stove", 300, 50)
    words = {name: card for name, card in SIMULATOR.tasks.items() if name.startswith("pro-language-")}
    assert all(card.published_instruction == SIMULATOR.tasks[name[13:]].instruction for name, card in words.items())


def test_each_axis_of_liberopro_has_ten_tasks_of_each_of_four_suites():
    counts = Counter(name.split("-")[1] for name in SIMULATOR.tasks if name.startswith("pro-"))
    assert counts == dict.fromkeys(("object", "swap", "task", "language"), 40)
    assert {SIMULATOR.tasks[name].variant_of for name in SIMULATOR.tasks if name.startswith("pro-swap-")} == {
        f"libero/{name}" for name in SIMULATOR.tasks if name.split("-")[0] in ("spatial", "object", "goal", "10")
    }

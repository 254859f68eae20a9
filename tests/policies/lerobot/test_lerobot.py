"""LeRobot checkpoints act as in LeRobot itself, and a mismatch is one line before the start."""

import math
import os
import shutil

import numpy as np
import pytest

from robogauntlet.adapters.contract import ActionSpec, ObservationSpec
from robogauntlet.orchestrator.environments.resolver import EnvironmentResolver
from robogauntlet.orchestrator.episodes.episode_runner import EpisodeRunner
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import PolicyError, PolicyMismatch, Query, check_fit
from robogauntlet.policies.lerobot.checkpoint import read_checkpoint
from robogauntlet.policies.lerobot.lerobot_policy import ProcessLost
from tests.errors import one_line_error
from tests.policies.lerobot.asking import CHUNK, EPISODE, answers, make
from tests.processes import run_gauntlet


@pytest.fixture(scope="session")
def made(each_python, tmp_path_factory):
    """Folder with a checkpoint of ACT, LeRobot's actions and the queries."""
    return make(each_python, tmp_path_factory.mktemp("lerobot"), "act")


@pytest.fixture(scope="module")
def played(each_python, made):
    """ACT, in one process for the tests of this file."""
    policy = catalog.load("lerobot", {"checkpoint": str(made / "act"), "python": each_python})
    yield policy
    policy.close()


@pytest.mark.slow
def test_actions_of_act_are_bit_identical_to_lerobots(played, made):
    assert played.spec.chunk_length == CHUNK["act"]
    np.testing.assert_array_equal(*answers(played, made, "act"))


@pytest.mark.nightly
def test_a_diffusion_policy_observes_every_step_and_its_actions_are_bit_identical_to_lerobots(each_python, tmp_path):
    made = make(each_python, tmp_path, "diffusion")
    policy = catalog.load("lerobot", {"checkpoint": str(made / "diffusion"), "python": each_python})
    assert policy.spec.chunk_length == CHUNK["diffusion"]
    np.testing.assert_array_equal(*answers(policy, made, "diffusion"))
    policy.close()


@pytest.mark.slow
def test_an_episode_is_the_same_when_replayed_after_its_process_died(played, made):
    runner = EpisodeRunner({}, remote_policies={"p": played})
    whole = runner.play_one(EPISODE)
    assert (whole.status, whole.steps) == ("failure", 6)
    assert whole.inference_s > 0

    def dying(simulation, step):
        if step == 2 and not died:  # between its two chunks
            died.append(played._process._process.pid)
            played._process._process.kill()
            played._process._process.wait()

    died = []
    again = runner.play_one(EPISODE, dying)
    assert played._process._process.pid != died[0]
    assert (again.status, again.actions_hash) == (whole.status, whole.actions_hash)
    played._process._process.kill()
    played._process._process.wait()
    played._process_of[EPISODE.id] = played._process
    with pytest.raises(ProcessLost, match="ended during the episode"):
        played.act([Query(EPISODE, 3, None)])


@pytest.mark.nightly
def test_weights_that_cannot_be_read_are_one_line(each_python, made, tmp_path):
    shutil.copytree(made / "act", tmp_path / "broken")
    (tmp_path / "broken" / "model.safetensors").write_bytes(b"none")
    with pytest.raises(PolicyError, match=r"^policy 'lerobot': SafetensorError: "):
        catalog.load("lerobot", {"checkpoint": str(tmp_path / "broken"), "python": each_python})


@pytest.mark.nightly
def test_without_a_newer_python_an_older_lerobot_is_made_and_the_reason_told(tmp_path):
    without = {"PATH": "/nowhere", "PYENV_ROOT": "/nowhere", "ROBOGAUNTLET_ENVIRONMENTS": str(tmp_path)}
    done = run_gauntlet("env", "create", "lerobot", timeout=900, **without)
    needs = "lerobot[diffusion,pi,smolvla]==0.6.1 needs Python 3.12 or 3.13, and none that starts is on the PATH"
    assert needs in done.stdout, done.stderr
    assert "lerobot 0.4.4" in done.stdout.splitlines()[-1]


def test_the_hash_covers_files_and_conversions_but_not_the_folder(bare, tmp_path):
    folder = bare()
    hashes = [catalog.digest("lerobot", {"checkpoint": str(folder)})]
    shutil.copytree(folder, tmp_path / "copy")
    assert catalog.digest("lerobot", {"checkpoint": str(tmp_path / "copy"), "python": "/x"}) == hashes[0]
    hashes.append(catalog.digest("lerobot", {"checkpoint": str(folder), "translation_scale": 0.05}))
    (folder / "model.safetensors").write_text("other")
    hashes.append(catalog.digest("lerobot", {"checkpoint": str(folder)}))
    assert len(set(hashes)) == len(hashes)


def test_a_checkpoint_trained_on_liberos_data_uses_its_convention(bare):
    options = read_checkpoint({"checkpoint": str(bare()), "convention": "libero"}).options
    assert (options.turn, options.translation_scale, options.rotation_scale) == ("left-right", 0.0131, 0.118)


def test_a_checkpoint_of_an_so101_plays_its_tasks_and_no_others(bare):
    six = {"observation.images.front": {"shape": [3, 32, 32]}, "observation.state": {"shape": [6]}}
    folder = bare(input_features=six, output_features={"action": {"shape": [6]}})
    spec = catalog.spec("lerobot", {"checkpoint": str(folder), "convention": "so101"})
    assert spec.can_act_in("so101/Stack")
    assert not spec.can_act_in("robosuite/Lift")
    hint = "expected observation.state of 8 numbers .*; for others give option convention: so101, aloha, droid or"
    with one_line_error(PolicyError, hint):
        catalog.spec("lerobot", {"checkpoint": str(folder)})


def test_a_checkpoint_of_droid_plays_tasks_by_velocities_and_not_by_targets(bare):
    eight = {"observation.images.front": {"shape": [3, 32, 32]}, "observation.state": {"shape": [8]}}
    folder = bare(input_features=eight, output_features={"action": {"shape": [8]}})
    spec = catalog.spec("lerobot", {"checkpoint": str(folder), "convention": "droid"})
    assert spec.can_act_in("robosuite/Lift@DROID-joint-velocity")
    assert not spec.can_act_in("robosuite/Lift@DROID-joint-position")


def test_a_checkpoint_sets_chunk_length_and_image_size(bare):
    spec = read_checkpoint({"checkpoint": str(bare())}).spec
    assert (spec.chunk_length, spec.cameras, spec.image_size) == (3, ("third_person",), 32)
    assert read_checkpoint({"checkpoint": str(bare(n_obs_steps=2))}).spec.chunk_length == 1


IMAGE, STATE8 = {"shape": [3, 256, 256]}, {"shape": [8]}
LIBEROS = {"observation.images.image": IMAGE, "observation.images.image2": IMAGE, "observation.state": STATE8}
CAMERAS = {"third_person": "observation.images.image", "wrist": "observation.images.image2"}


def test_cameras_that_lerobot_fills_itself_need_no_source_and_no_size(bare):
    """As it writes them for pi0, pi0.5, SmolVLA and X-VLA."""
    filled = {f"observation.images.empty_camera_{number}": {"shape": [3, 480, 640]} for number in range(2)}
    folder = str(bare(input_features={**LIBEROS, **filled}, empty_cameras=2))
    spec = catalog.spec("lerobot", {"checkpoint": folder, "cameras": CAMERAS})
    assert (spec.cameras, spec.image_size) == (("third_person", "wrist"), 256)
    folder = str(bare(input_features={**LIBEROS, **filled}, empty_cameras=1))
    with one_line_error(PolicyError, r"needs observation\.images\.empty_camera_1, which no option provides"):
        catalog.spec("lerobot", {"checkpoint": folder, "cameras": CAMERAS})


@pytest.mark.parametrize("wrist", ["image2", "wrist_image"])
def test_cameras_have_their_names_in_liberos_data_under_its_convention(bare, wrist):
    named = f"observation.images.{wrist}"
    features = {"observation.images.image": IMAGE, named: IMAGE, "observation.state": STATE8}
    folder = str(bare(input_features=features))
    options = read_checkpoint({"checkpoint": folder, "convention": "libero"}).options
    assert options.cameras == {"third_person": "observation.images.image", "wrist": named}
    example = rf"for example cameras: {{third_person: observation\.images\.image, wrist: {named}}}$"
    with one_line_error(PolicyError, example):
        read_checkpoint({"checkpoint": folder})


NUMBERS = [None, [], "3", True, -5, 0, 2.5, math.inf, -math.inf, math.nan, 10**30]


@pytest.mark.parametrize("name", ["n_action_steps", "n_obs_steps", "empty_cameras"])
@pytest.mark.parametrize("number", NUMBERS)
def test_a_number_of_the_configuration_that_is_none_is_one_line(bare, name, number):
    if (name, number) != ("empty_cameras", 0) or number is False:
        with one_line_error(PolicyError, f"config.json, got: {name}: expected a whole number from [01] to "):
            catalog.digest("lerobot", {"checkpoint": str(bare(**{name: number}))})


@pytest.mark.parametrize("shape", [*NUMBERS, [None], [-7], [math.inf], [[7]], {"a": 7}])
def test_a_shape_that_is_none_is_one_line(bare, shape):
    with one_line_error(PolicyError, "expected a configuration of LeRobot in "):
        catalog.digest("lerobot", {"checkpoint": str(bare(output_features={"action": {"shape": shape}}))})


def test_files_that_are_none_are_one_line(bare):
    def refused(match):
        with one_line_error(PolicyError, match):
            catalog.digest("lerobot", {"checkpoint": str(folder)})

    folder = bare()
    os.mkfifo(folder / "more.json")
    refused(r"more\.json: a named pipe, no regular file")
    (folder / "more.json").unlink()
    os.truncate(folder / "model.safetensors", 6 * 10**10)
    refused(r"model\.safetensors: 60,000,000,000 bytes of holes")
    os.truncate(folder / "config.json", 16_000_001)
    refused("more than 16,000,000 bytes")


TWO = {"observation.images.a": {"shape": [3, 32, 32]}, "observation.images.b": {"shape": [3, 32, 32]}}


@pytest.mark.parametrize(
    ("changed", "options", "message"),
    [
        ({"input_features": TWO}, {}, "a camera to each of observation.images.a, observation.images.b"),
        ({}, {"cameras": {"wrist": "observation.images.rear"}}, "expected a feature of the checkpoint"),
        ({"input_features": TWO}, {"cameras": {"wrist": "observation.images.a"}}, "needs observation.images.b"),
        ({"input_features": {"observation.state": {"shape": [6]}}}, {}, "expected observation.state of 8 numbers"),
        ({}, {"image_size": 64}, r"image_size: expected \[32, 32\], as the checkpoint was trained on"),
        ({"output_features": {"action": {"shape": [6]}}}, {}, "expected the 7 columns of an action"),
        ({"input_features": 3}, {}, "expected a configuration of LeRobot in"),
        ({}, {"device": "CPU 1"}, "device: String should match pattern"),
    ],
)
def test_a_mismatch_is_one_line_before_anything_starts(bare, changed, options, message):
    with one_line_error(PolicyError, message):
        catalog.spec("lerobot", {"checkpoint": str(bare(**changed)), **options})


def test_the_message_for_another_version_names_the_missing_file(bare):
    folder = bare()
    (folder / "policy_preprocessor.json").unlink()
    message = r"a checkpoint of LeRobot 0\.4 or newer .* it lacks policy_preprocessor.json"
    with pytest.raises(PolicyError, match=message):
        catalog.digest("lerobot", {"checkpoint": str(folder)})


def test_a_checkpoint_that_is_neither_folder_nor_on_the_hub_is_one_line(monkeypatch):
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_OFFLINE", True)
    message = r"^policy 'lerobot': no folder no-user/no-model, .* does not provide it: .+$"
    with pytest.raises(PolicyError, match=message):
        catalog.digest("lerobot", {"checkpoint": "no-user/no-model"})
    with pytest.raises(PolicyError, match=r"expected a folder or an id on the hub, got './nothing'"):
        catalog.digest("lerobot", {"checkpoint": "./nothing"})


def test_without_lerobot_the_message_says_how_to_install_it(bare):
    with pytest.raises(PolicyError, match="not installed; install it: robogauntlet env create lerobot"):
        catalog.load("lerobot", {"checkpoint": str(bare())})


def test_images_of_another_size_do_not_fit(bare):
    spec = catalog.spec("lerobot", {"checkpoint": str(bare())})
    with pytest.raises(PolicyMismatch, match="made for 32 px images, the suite renders 96 px"):
        check_fit(spec, ActionSpec(1.0, 1.0, 1.0), ObservationSpec(("third_person",), 96))


def test_lerobot_beside_robogauntlet_is_used_and_needs_no_environment(tmp_path, monkeypatch):
    (tmp_path / "lerobot").mkdir()
    (tmp_path / "lerobot" / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    assert EnvironmentResolver().options("lerobot", {"checkpoint": "x/y"}) == {"checkpoint": "x/y"}

"""Training: learning, determinism, resumption, metadata and error messages."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from safetensors.torch import load_file

from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.training.dataset import Demonstrations
from robogauntlet.policies.training.lerobot_format import DatasetError
from robogauntlet.suites.episode import FIRST_TRAINING_SEED
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint, load_tensors, save_checkpoint
from robogauntlet_mergevla.checkpoints.metadata import METADATA_FILE, WEIGHTS, CheckpointMetadata
from robogauntlet_mergevla.cli.training_progress import line
from robogauntlet_mergevla.network.config import LoraSettings, PaperCodeQuirks
from robogauntlet_mergevla.network.normalisation import Statistics
from robogauntlet_mergevla.policies.single_policy import load_network
from robogauntlet_mergevla.training.augmentation import change_words, shift
from robogauntlet_mergevla.training.batch_loss import Objective, masked_l1
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
from robogauntlet_mergevla.training.finetune import TrainingStatus, finetune, pretrain
from robogauntlet_mergevla.training.lambda_selection import held_out_l1
from robogauntlet_mergevla.training.settings import Schedule, Settings, rate_at
from robogauntlet_mergevla.training.training_checkpoint import (
    STATE_FILE,
    History,
    TrainingError,
    load_state,
    save_state,
)
from tests.errors import one_line_error
from tests.mergevla.network.test_pretrained import LITTLE
from tests.mergevla.shared import SMALL
from tests.policies.training.synthetic import recording, write

LORA = LoraSettings(4)
QUICK = Settings(steps=6, batch_size=8, warm_up=2, evaluate_every=3, largest_shift=1)


def episode(seed, size=16, steps=12, **changes):
    """The motion's sign is in the picture: bright means +1."""
    sign = 1.0 if seed % 2 else -1.0
    frames = list(np.full((steps, size, size, 3), 128 + 100 * sign, np.uint8))
    actions = np.zeros((steps, 7))
    actions[:, :3], actions[:, 6] = sign * 0.05, sign
    return recording(seed, steps, actions=actions, images={"third_person": frames, "wrist": frames}, **changes)


def dataset(folder, name, seeds=range(6), **options):
    write(
        folder / name,
        [episode(FIRST_TRAINING_SEED + seed, **options) for seed in seeds],
        per_file=1,
        task=f"null/{name}",
    )
    return folder / name


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    return [dataset(folder, "Reach"), dataset(folder, "Push", range(10, 14), instruction="push the cube")]


@pytest.fixture(scope="module")
def pool(data):
    return DatasetMixture.open(data)


@pytest.fixture(scope="module")
def base(pool, tmp_path_factory):
    folder = tmp_path_factory.mktemp("base")
    pretrain(pool, SMALL, folder, QUICK)
    return folder


def stop_after(steps):
    """A `Stop` that stops after this number of steps."""
    left = iter(range(steps))
    return lambda: next(left, None) in (steps - 1, None)


def test_loss_falls(pool, tmp_path):
    settings = replace(QUICK, steps=60, batch_size=16, learning_rate=5e-3)
    losses = pretrain(pool, SMALL, tmp_path, settings).history.losses
    assert np.mean(losses[-5:]) < 0.5 * np.mean(losses[:5])


def test_held_out_episodes_are_never_trained_on(data):
    pool = DatasetMixture.open(data[:1])
    seen = {row.tobytes() for step in range(30) for row in pool.sample(16, seed=0, step=step, chunk_length=8).states}
    held_out = {row.tobytes() for batch in pool.held_out(16, chunk_length=8) for row in batch.states}
    assert len(held_out) == 12
    assert not seen & held_out


def test_statistics_leave_out_held_out_episodes(tmp_path):
    odd = {"actions": np.full((12, 7), 0.9), "states": np.full((12, 8), 50.0)}
    first, second, third = range(FIRST_TRAINING_SEED, FIRST_TRAINING_SEED + 3)
    write(tmp_path, [recording(first), recording(second), recording(third, **odd)])
    (task,) = (pool := DatasetMixture.open([tmp_path])).tasks
    data = Demonstrations(tmp_path)
    assert pool.statistics.of(task) == Statistics.of(data.actions[:24], data.states[:24])


def test_equal_seeds_give_equal_weights_and_others_do_not(pool, base, tmp_path):
    again = pretrain(pool, SMALL, tmp_path / "again", QUICK).metadata
    other = pretrain(pool, SMALL, tmp_path / "other", replace(QUICK, seed=1)).metadata
    assert again.tensor_hash == CheckpointMetadata.read(base).tensor_hash != other.tensor_hash


@pytest.mark.parametrize(
    "change",
    [
        {"learning_rate": 2e-3},
        {"warm_up": 0},
        {"schedule": Schedule.CONSTANT},
        {"weight_decay": 0.5},
        {"clip": 1e-3},
        {"batch_size": 4},
    ],
)
def test_each_decisive_setting_changes_the_weights(pool, base, tmp_path, change):
    metadata = pretrain(pool, SMALL, tmp_path, replace(QUICK, **change)).metadata
    assert metadata.tensor_hash != CheckpointMetadata.read(base).tensor_hash


def test_data_that_start_as_an_evaluation_does_are_refused(tmp_path):
    write(tmp_path, [recording(FIRST_TRAINING_SEED), recording(7)])
    with one_line_error(DatasetError, "expected seeds from 1000000 on, which are for training, got 7: a policy"):
        DatasetMixture.open([tmp_path])


def test_images_are_shifted_up_to_the_setting(tmp_path):
    write(tmp_path, [recording(FIRST_TRAINING_SEED + number) for number in range(2)])
    pool = DatasetMixture.open([tmp_path])
    metadata = [pretrain(pool, SMALL, tmp_path / str(px), replace(QUICK, largest_shift=px)).metadata for px in (0, 1)]
    assert metadata[0].tensor_hash != metadata[1].tensor_hash


def test_a_fresh_trunk_is_initialised_by_its_seed_and_not_from_the_base(pool, base, tmp_path):
    barely = replace(QUICK, steps=1, learning_rate=1e-9)
    for name, seed in (("base", None), ("one", 1), ("again", 1), ("two", 2)):
        finetune(pool, base, tmp_path / name, barely, lora=LORA, fresh_trunk=seed)
    weights = {name: load_tensors(tmp_path / name)[0] for name in ("base", "one", "again", "two")}
    trunk = [name for name in weights["base"] if not name.startswith("backbone.") and name.endswith("weight")]
    matrices = [name for name in trunk if weights["base"][name].ndim == 2]
    for name in matrices:
        assert torch.equal(weights["one"][name], weights["again"][name])
        assert not torch.allclose(weights["one"][name], weights["base"][name], atol=1e-3)
        assert not torch.allclose(weights["one"][name], weights["two"][name], atol=1e-3)
    backbone = next(name for name in weights["base"] if name.startswith("backbone.vision"))
    assert torch.equal(weights["one"][backbone], weights["base"][backbone])
    assert CheckpointMetadata.read(tmp_path / "two").metrics["fresh_trunk"] == 2


def test_adapters_are_initialised_by_their_seed(pool, base, tmp_path):
    barely = replace(QUICK, steps=1, learning_rate=1e-9)
    for seed in (0, 1):
        finetune(pool, base, tmp_path / str(seed), replace(barely, seed=seed), lora=LORA)
    ours, theirs = (load_file(tmp_path / str(seed) / WEIGHTS) for seed in (0, 1))
    assert all(not torch.allclose(ours[name], theirs[name], atol=1e-4) for name in ours if name.endswith("lora_A"))


def test_stopped_and_continued_equals_uninterrupted_bit_for_bit(data, base, tmp_path):
    pool = DatasetMixture.open(data[:1])
    whole = finetune(pool, base, tmp_path / "whole", QUICK, lora=LORA)
    for steps in (1, 2):
        assert finetune(pool, base, tmp_path / "parts", QUICK, lora=LORA, stop=stop_after(steps)).metadata is None
    parts = finetune(DatasetMixture.open(data[:1]), base, tmp_path / "parts", QUICK, lora=LORA)
    ours, theirs = (load_file(tmp_path / name / WEIGHTS) for name in ("whole", "parts"))
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
    assert parts.history.losses == whole.history.losses
    assert parts.history.held_out == whole.history.held_out
    assert not (tmp_path / "parts" / STATE_FILE).exists()


def test_a_training_of_weights_without_gradient_is_continued(tmp_path):
    """The large size's towers: their last block is not read."""
    pool = DatasetMixture.open([dataset(tmp_path, "Reach", range(3), size=LITTLE.image_size, steps=4)])
    brief = replace(QUICK, steps=2, batch_size=2)
    whole = pretrain(pool, LITTLE, tmp_path / "whole", brief).metadata
    pretrain(pool, LITTLE, tmp_path / "parts", brief, stop=stop_after(1))
    assert pretrain(pool, LITTLE, tmp_path / "parts", brief).metadata.tensor_hash == whole.tensor_hash


def test_the_papers_noise_is_the_same_in_a_continued_training_and_absent_in_evaluations(pool, tmp_path):
    noisy = replace(SMALL, quirks=PaperCodeQuirks(training_noise=True))
    whole = pretrain(pool, noisy, tmp_path / "whole", QUICK)
    pretrain(pool, noisy, tmp_path / "parts", QUICK, stop=stop_after(2))
    torch.manual_seed(1)
    assert pretrain(pool, noisy, tmp_path / "parts", QUICK).metadata.tensor_hash == whole.metadata.tensor_hash
    checkpoint = load_checkpoint(tmp_path / "whole")
    losses = held_out_l1(lambda task: checkpoint.model, checkpoint.metadata.statistics, pool)
    assert np.mean(list(losses.values())) == pytest.approx(whole.metadata.metrics["held_out_l1"], rel=1e-5)


def test_moments_are_restored_on_the_device_of_their_weight(tmp_path):
    """The count of steps too, since fused AdamW reads it on the GPU."""
    weight = torch.nn.Parameter(torch.ones(2))
    optimiser = torch.optim.AdamW([weight])
    weight.sum().backward()
    optimiser.step()
    save_state(tmp_path / STATE_FILE, {"w": weight}, optimiser, History("same", step=1))
    on_meta = torch.nn.Parameter(torch.empty(2, device="meta"))
    continued = torch.optim.AdamW([on_meta])
    load_state(tmp_path / STATE_FILE, {"w": on_meta}, continued, "same")
    found = continued.state[on_meta]
    assert found.keys() == optimiser.state[weight].keys()
    assert {value.device.type for value in found.values()} == {"meta"}


def test_the_state_is_written_while_training(pool, tmp_path):
    there, settings = [], replace(QUICK, save_s=0.0)
    pretrain(pool, SMALL, tmp_path, settings, listener=lambda pace: there.append((tmp_path / STATE_FILE).exists()))
    assert there == [False, True, True, True, True, True]


def test_a_killed_training_continues_from_the_state_that_was_written(pool, base, tmp_path):
    def die(pace):
        if pace.step == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pretrain(pool, SMALL, tmp_path, replace(QUICK, save_s=0.0), listener=die)
    assert pretrain(pool, SMALL, tmp_path, QUICK).metadata.tensor_hash == CheckpointMetadata.read(base).tensor_hash


def test_the_metadata_describe_training_and_data(pool, base, data, tmp_path):
    finetune(DatasetMixture.open(data[1:]), base, tmp_path, QUICK, lora=LORA)
    metadata = CheckpointMetadata.verified(tmp_path)
    assert metadata.tasks == ("null/Push",)
    assert metadata.data_hash == DatasetMixture.open(data[1:]).data_hash
    assert metadata.lora == LORA
    assert metadata.base_hash == CheckpointMetadata.read(base).tensor_hash
    assert metadata.metrics["seed"] == 0
    assert 0.0 < metadata.metrics["train_l1"] < 2.0
    assert 0.0 < metadata.metrics["held_out_l1"] < 2.0
    assert CheckpointMetadata.read(base).tasks == ("null/Push", "null/Reach")


def test_an_expert_differs_from_its_base_in_adapters_and_action_expert_only(data, base, tmp_path):
    finetune(DatasetMixture.open(data[:1]), base, tmp_path, QUICK, lora=LORA)
    before, _ = load_tensors(base)
    after, _ = load_tensors(tmp_path)
    backbone = {name for name in before if name.startswith("backbone.")}
    assert all(torch.equal(before[name], after[name]) for name in backbone)
    assert {name.split(".")[0] for name in after.keys() - before.keys()} == {"backbone"}
    assert not torch.equal(before["action_expert.output.weight"], after["action_expert.output.weight"])
    assert load_checkpoint(tmp_path).metadata.statistics != CheckpointMetadata.read(base).statistics


def test_an_expert_of_a_base_in_half_precision_stores_the_same_parts_and_acts_in_it(data, base, tmp_path):
    start = load_checkpoint(base)
    save_checkpoint(tmp_path / "base", start.model.bfloat16(), start.metadata)
    finetune(DatasetMixture.open(data[:1]), tmp_path / "base", tmp_path / "expert", QUICK, lora=LORA)
    stored = load_file(tmp_path / "expert" / "model.safetensors")
    assert all(".lora_" in name or not name.startswith("backbone.") for name in stored)
    assert {tensor.dtype for tensor in stored.values()} == {torch.float32}
    acting = load_network(tmp_path / "expert", torch.device("cpu")).model
    assert {tensor.dtype for tensor in acting.state_dict().values()} == {torch.bfloat16}


def test_an_expert_stored_in_bfloat16_is_trained_as_any_other(data, base, tmp_path):
    mixture = DatasetMixture.open(data[:1])
    finetune(mixture, base, tmp_path / "whole", QUICK, lora=LORA)
    finetune(mixture, base, tmp_path / "half", QUICK, lora=LORA, dtype=torch.bfloat16)
    whole, half = (load_file(tmp_path / folder / WEIGHTS) for folder in ("whole", "half"))
    assert whole.keys() == half.keys()
    assert all(torch.equal(tensor.bfloat16(), half[name]) for name, tensor in whole.items())


def test_the_loss_leaves_out_masked_steps():
    predicted, target = torch.zeros(2, 3, 7), torch.ones(2, 3, 7)
    target[1, 1:] = 100.0
    mask = torch.tensor([[True, True, True], [True, False, False]])
    assert masked_l1(predicted, target, mask[..., None].expand(2, 3, 7)) == 1.0


@given(st.integers(1, 300), st.integers(0, 50), st.sampled_from(Schedule))
def test_learning_rates_rise_then_never_rise(steps, warm_up, schedule):
    rates = [rate_at(step, steps=steps, warm_up=warm_up, schedule=schedule) for step in range(steps)]
    assert all(0.0 < rate <= 1.0 for rate in rates)
    assert rates[:warm_up] == sorted(rates[:warm_up])
    assert rates[warm_up:] == sorted(rates[warm_up:], reverse=True)


def test_a_shift_moves_down_and_right_and_repeats_the_border():
    image = np.arange(16, dtype=np.uint8).reshape(1, 4, 4, 1).repeat(3, axis=-1)
    moved = shift(image, np.array([[1, -1]]), 2)
    assert moved[0, 1:, :-1, 0].tolist() == image[0, :-1, 1:, 0].tolist()
    assert moved[0, 0, :-1, 0].tolist() == image[0, 0, 1:, 0].tolist()


@given(st.lists(st.sampled_from(["lift", "the", "red cube", ""]), max_size=4), st.integers(0, 9), st.floats(0.0, 1.0))
def test_changed_words_come_from_the_sentence_or_are_random(instructions, seed, share):
    changed = change_words(instructions, np.random.default_rng(seed), share)
    for before, after in zip(instructions, changed, strict=True):
        kept = [word for word in after.split() if len(word) != 5]
        assert set(kept) <= set(before.split())
        assert len(after.split()) <= 2 * len(before.split())
        assert share or before == after


def test_settings_without_changed_words_are_those_of_older_trainings():
    assert "changed_words" not in QUICK.decisive
    assert replace(QUICK, changed_words=0.3).decisive == QUICK.decisive | {"changed_words": 0.3}


def test_a_third_of_the_changed_words_each_is_left_out_replaced_and_followed_by_another():
    words = change_words(["cube " * 3000], np.random.default_rng(0), 0.6)[0].split()
    kept = words.count("cube")
    assert kept / 3000 == pytest.approx(0.6, abs=0.03)
    assert (len(words) - kept) / 3000 == pytest.approx(0.4, abs=0.03)


def test_words_are_changed_in_training_batches_alone_and_nothing_else_is(pool):
    plain, changed = (
        pool.sample(16, seed=3, step=2, chunk_length=4, largest_shift=1, changed_words=share) for share in (0.0, 0.9)
    )
    assert set(plain.instructions) == {
        text for batch in pool.held_out(8, chunk_length=4) for text in batch.instructions
    }
    assert all(one != other for one, other in zip(plain.instructions, changed.instructions, strict=True))
    np.testing.assert_array_equal(plain.actions, changed.actions)
    for camera, images in plain.images.items():
        np.testing.assert_array_equal(images, changed.images[camera])


def test_progress_is_one_line():
    text = line(TrainingStatus(400, 2000, 0.0812, 0.0934, 6.2, 258.0, Objective.L1))
    assert text == "step 400/2000  L1 0.0812  held-out L1 0.0934  6.2 steps/s  4 min 18 s left"


def test_mistakes_are_one_line(pool, base, data, tmp_path):
    wide, expert = dataset(tmp_path, "Wide", size=32), tmp_path / "expert"
    upward = replace(SMALL, cameras=("top",))
    finetune(DatasetMixture.open(data[:1]), base, expert, QUICK, lora=LORA)
    mistakes = {
        "expected 16 px images": lambda: finetune(DatasetMixture.open([wide]), base, tmp_path / "a", QUICK, lora=LORA),
        "expected 16 px images of": lambda: DatasetMixture.open([data[0], wide]),
        "expected a dataset": lambda: DatasetMixture.open([tmp_path / "nowhere"]),
        "steps: expected greater than 0, got 0": lambda: Settings.from_json({"steps": 0}),
        "seed: expected less than 9223372036854775808": lambda: Settings.from_json({"seed": 2**63}),
        "seed: expected greater than or equal to 0, got -1": lambda: Settings.from_json({"seed": -1}),
        "learning_rate: expected less than 1, got 2.0": lambda: Settings.from_json({"learning_rate": 2.0}),
        "schedule: expected 'cosine' or 'constant', got 'step'": lambda: Settings.from_json({"schedule": "step"}),
        "expected a base, got": lambda: finetune(pool, expert, tmp_path / "b", QUICK, lora=LORA),
        "holds a finished one": lambda: pretrain(pool, SMALL, base, QUICK),
        "expected a checkpoint's folder or a hub id": lambda: finetune(pool, "none", tmp_path, QUICK, lora=LORA),
        "expected images of camera top": lambda: pretrain(pool, upward, tmp_path / "c", QUICK),
    }
    for message, mistake in mistakes.items():
        with one_line_error(PolicyError, message):
            mistake()


def test_a_stopped_training_is_not_continued_with_other_settings(pool, tmp_path):
    pretrain(pool, SMALL, tmp_path, QUICK, stop=stop_after(2))
    with pytest.raises(TrainingError, match="expected the same data, base and settings"):
        pretrain(pool, SMALL, tmp_path, replace(QUICK, seed=5))
    assert not (tmp_path / METADATA_FILE).exists()


def test_a_stopped_training_is_not_continued_with_its_data_in_another_order(data, tmp_path):
    pretrain(DatasetMixture.open(data), SMALL, tmp_path, QUICK, stop=stop_after(2))
    backwards = DatasetMixture([Demonstrations(folder) for folder in sorted(data, reverse=True)])
    assert backwards.data_hash == DatasetMixture.open(data).data_hash
    with pytest.raises(TrainingError, match="expected the same data, base and settings"):
        pretrain(backwards, SMALL, tmp_path, QUICK)


def test_a_broken_state_file_is_an_error(pool, tmp_path):
    (tmp_path / STATE_FILE).write_bytes(b"nothing")
    with pytest.raises(TrainingError, match="does not read"):
        pretrain(pool, SMALL, tmp_path, QUICK)

"""The loss without actions: what matches, what it trains, and that it reads no action."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st
from typer.testing import CliRunner

from robogauntlet.orchestrator.cli import app
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_tensors
from robogauntlet_mergevla.checkpoints.metadata import METADATA_FILE, CheckpointMetadata
from robogauntlet_mergevla.network import config
from robogauntlet_mergevla.network.model import build
from robogauntlet_mergevla.training.batch_loss import TEMPERATURE, Objective, contrastive_loss
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
from robogauntlet_mergevla.training.finetune import pretrain
from robogauntlet_mergevla.training.settings import Settings
from tests.mergevla.shared import SMALL
from tests.mergevla.training.test_finetune import dataset

TRAINED = ("backbone.", "action_queries")
QUICK = Settings(steps=3, batch_size=8, warm_up=1, evaluate_every=3, largest_shift=1)


def test_two_rows_that_find_each_other_have_the_loss_worked_out_by_hand():
    rows = torch.eye(2, dtype=torch.float64)
    loss = contrastive_loss(rows, rows, torch.eye(2, dtype=torch.bool))
    assert loss.item() == pytest.approx(math.log(1 + math.exp(-1 / TEMPERATURE)))


def test_all_matches_of_a_row_count_as_found():
    everything = torch.ones(3, 3, dtype=torch.bool)
    assert contrastive_loss(torch.randn(3, 4), torch.randn(3, 4), everything).item() == pytest.approx(0.0, abs=1e-6)


@given(st.integers(0, 2**31), st.floats(0.1, 10.0))
def test_the_loss_does_not_depend_on_order_length_or_side(seed, length):
    generator = torch.Generator().manual_seed(seed)
    one, other = (torch.randn(5, 4, generator=generator) for _ in range(2))
    matches, order = torch.eye(5, dtype=torch.bool), torch.randperm(5, generator=generator)
    loss = contrastive_loss(one, other, matches).item()
    assert loss >= 0.0
    for alike in ((one[order], other[order]), (length * one, other), (other, one)):
        assert contrastive_loss(*alike, matches).item() == pytest.approx(loss, abs=1e-4)


@pytest.fixture(scope="module")
def pool(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    dark, bright = range(0, 12, 2), range(1, 13, 2)
    return DatasetMixture.open(
        [dataset(folder, "Reach", dark), dataset(folder, "Push", bright, instruction="push the cube")]
    )


def matched(pool, folder, **changes):
    settings = replace(QUICK, **changes)
    return pretrain(pool, SMALL, folder, settings, objective=Objective.MATCHING)


def test_only_the_backbone_and_the_queries_are_trained(pool, tmp_path):
    assert matched(pool, tmp_path).metadata.metrics["without_actions"] == 1
    before, (after, _) = build(SMALL, QUICK.seed).state_dict(), load_tensors(tmp_path)
    changed = {name for name, weight in after.items() if not torch.equal(weight, before[name])}
    assert changed
    assert {name for name in changed if not name.startswith(TRAINED)} == set()


def test_neither_actions_nor_proprioception_are_read(pool, tmp_path):
    other = DatasetMixture(pool.datasets)
    before = [(data.actions, data.states) for data in other.datasets]
    matched(pool, tmp_path / "one")
    for data, (actions, states) in zip(other.datasets, before, strict=True):
        data.actions, data.states = np.flip(actions) + 1.0, states - 2.0
    matched(other, tmp_path / "two")
    for data, (actions, states) in zip(other.datasets, before, strict=True):
        data.actions, data.states = actions, states
    (one, _), (two, _) = load_tensors(tmp_path / "one"), load_tensors(tmp_path / "two")
    assert all(torch.equal(weight, two[name]) for name, weight in one.items())


def test_the_loss_falls(pool, tmp_path):
    losses = matched(pool, tmp_path, steps=60, learning_rate=2e-3).history.losses
    assert np.mean(losses[-5:]) < 0.6 * np.mean(losses[:5])


def test_the_command_line_says_what_it_minimises(pool, tmp_path, monkeypatch):
    monkeypatch.setitem(config.SIZES, "small", SMALL)
    data, out = str(pool.datasets[0].folder.parent), tmp_path / "base"
    arguments = [data, "--out", str(out), "--size", "small", "--steps", "2", "--batch-size", "4"]
    done = CliRunner().invoke(app, ["mergevla", "pretrain", *arguments, "--without-actions"])
    assert done.exit_code == 0, done.exception
    assert "step 2/2  matching loss " in done.output
    assert f"{out}: matching loss " in done.output.replace("\n", "")
    metrics = CheckpointMetadata.read(out).metrics
    assert metrics["train_matching"] > 0.0
    assert not any(name.startswith("held_out") for name in metrics)  # a held-out batch has one sentence
    assert (out / METADATA_FILE).exists()

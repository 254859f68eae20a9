"""The policy of one network. What it shares with the other kinds is in `test_merged_policy`."""

import sys

import numpy as np
import pytest
import torch

from robogauntlet.adapters.contract import ACTION_DIM
from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.checkpoints.expert_checkpoint import save_checkpoint
from robogauntlet_mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet_mergevla.kinds import KIND
from robogauntlet_mergevla.network.config import LoraSettings
from robogauntlet_mergevla.network.lora import add_lora
from tests.mergevla.shared import SMALL, query, small_model, task_statistics


@pytest.fixture
def options(tmp_path):
    save_checkpoint(tmp_path / "expert", small_model(), CheckpointMetadata(SMALL, task_statistics()))
    return {"checkpoint": str(tmp_path / "expert")}


def test_the_spec_is_that_of_the_network(options):
    spec = KIND.load(options).spec
    assert (spec.chunk_length, spec.action_dim, spec.image_size) == (8, 7, 16)
    assert spec.cameras == ("third_person", "wrist")


def test_actions_are_restored_by_the_statistics_of_the_checkpoint(options, tmp_path):
    other = task_statistics(1)
    save_checkpoint(tmp_path / "other", small_model(), CheckpointMetadata(SMALL, other))
    normalised = torch.zeros(1, 8, ACTION_DIM)
    policy = KIND.load({"checkpoint": str(tmp_path / "other")})
    policy._network(tmp_path / "other").model.forward = lambda *_: normalised
    np.testing.assert_allclose(policy.act([query(0)])[0].actions, other.restore_actions(["null/Reach"], normalised)[0])


def test_a_checkpoint_with_adapters_acts_too(tmp_path):
    model = small_model()
    add_lora(model, LoraSettings(rank=2), 0)
    save_checkpoint(tmp_path / "a", model, CheckpointMetadata(SMALL, task_statistics(), lora=LoraSettings(rank=2)))
    save_checkpoint(tmp_path / "b", small_model(), CheckpointMetadata(SMALL, task_statistics()))
    one, two = (KIND.load({"checkpoint": str(tmp_path / name)}).act([query(0)])[0] for name in "ab")
    np.testing.assert_allclose(one.actions, two.actions, atol=1e-6)


def test_it_takes_one_thread(options):
    torch.set_num_threads(2)
    KIND.load(options)
    assert torch.get_num_threads() == 1


@pytest.mark.parametrize("wrong", [{}, {"checkpoint": 3}, {"checkpoint": ""}])
def test_options_without_a_checkpoint_are_refused(wrong):
    for use in (KIND.load, KIND.digest):
        with pytest.raises(PolicyError, match="expected option checkpoint"):
            use(wrong)


def test_missing_packages_are_one_line(options, monkeypatch):
    monkeypatch.delitem(sys.modules, "robogauntlet_mergevla.policies.single_policy", raising=False)
    monkeypatch.delitem(sys.modules, "robogauntlet_mergevla.checkpoints.expert_checkpoint", raising=False)
    monkeypatch.setitem(sys.modules, "safetensors.torch", None)
    with pytest.raises(PolicyError, match=r"not installed \(no module safetensors.*\./mergevla"):
        KIND.load(options)

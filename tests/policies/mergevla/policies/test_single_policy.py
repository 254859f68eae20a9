"""The policy: light to declare, independent of the batch, with actions in the units of the contract."""

import subprocess
import sys
import tomllib
from importlib import metadata

import numpy as np
import pytest
import torch

from robogauntlet.adapters.catalog import open_simulation
from robogauntlet.adapters.contract import ACTION_DIM
from robogauntlet.orchestrator.episodes.rollout import rollout
from robogauntlet.policies.contract import PolicyError, Query, check_fit
from robogauntlet.policies.mergevla.checkpoints.expert_checkpoint import save_checkpoint
from robogauntlet.policies.mergevla.checkpoints.metadata import CheckpointMetadata
from robogauntlet.policies.mergevla.kinds import KIND
from robogauntlet.policies.mergevla.network.config import LoraSettings
from robogauntlet.policies.mergevla.network.lora import add_lora
from robogauntlet.suites.episode import Episode, Protocol, View
from tests import ROOT
from tests.policies.mergevla.shared import SMALL, query, small_model, task_statistics


@pytest.fixture
def options(tmp_path):
    save_checkpoint(tmp_path / "expert", small_model(), CheckpointMetadata(SMALL, task_statistics()))
    return {"checkpoint": str(tmp_path / "expert")}


def test_declaring_the_kind_and_hashing_a_checkpoint_import_no_torch(options):
    program = (
        "import sys; from robogauntlet.policies.mergevla.kinds import KIND; "
        f"KIND.digest({options!r}); assert not {{'torch', 'transformers', 'peft', 'safetensors'}} & sys.modules.keys()"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_the_entry_point_names_the_kind():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    place = project["project"]["entry-points"]["robogauntlet.policies"][KIND.name]
    assert metadata.EntryPoint(KIND.name, place, "robogauntlet.policies").load() is KIND


def test_an_episode_is_the_same_when_played_twice(options):
    view = View(image_size=SMALL.image_size)
    simulation, policy = open_simulation("null/Reach", view), KIND.load(options)
    check_fit(policy.spec, simulation.action_spec, simulation.observation_spec)
    episode = Episode("p", KIND.digest(options), "null/Reach", 3, Protocol(horizon=20, view=view))
    one, two = rollout(simulation, policy, episode), rollout(simulation, policy, episode)
    assert (one.queries, one.actions_hash) == (3, two.actions_hash)


def test_the_spec_is_that_of_the_network(options):
    spec = KIND.load(options).spec
    assert (spec.chunk_length, spec.action_dim, spec.image_size) == (8, 7, 16)
    assert spec.cameras == ("third_person", "wrist")


def test_actions_in_a_batch_are_the_ones_alone(options):
    policy = KIND.load(options)
    queries = [query(seed) for seed in range(35)]
    together = policy.act(queries)
    assert len(together) == 35
    for one, decision in zip(queries, together, strict=True):
        np.testing.assert_allclose(decision.actions, policy.act([one])[0].actions, atol=1e-5)


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
    monkeypatch.delitem(sys.modules, "robogauntlet.policies.mergevla.policies.single_policy", raising=False)
    monkeypatch.delitem(sys.modules, "robogauntlet.policies.mergevla.checkpoints.expert_checkpoint", raising=False)
    monkeypatch.setitem(sys.modules, "safetensors.torch", None)
    with pytest.raises(PolicyError, match=r"not installed \(no module safetensors.*robogauntlet\[mergevla\]"):
        KIND.load(options)


def test_a_query_without_an_observation_is_refused(options):
    with pytest.raises(PolicyError, match="an observation in each query"):
        KIND.load(options).act([Query(query(0).episode, 0)])

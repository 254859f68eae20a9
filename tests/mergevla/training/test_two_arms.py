"""Networks of two arms, which tasks of one arm share."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from robogauntlet.adapters.contract import Body, Observation
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import Query
from robogauntlet.suites.episode import CAMERAS, FIRST_TRAINING_SEED, Episode, Protocol
from robogauntlet_mergevla.checkpoints.expert_checkpoint import load_checkpoint
from robogauntlet_mergevla.checkpoints.merge_experts import merge_experts, read_experts
from robogauntlet_mergevla.checkpoints.merged_checkpoint import save_merged
from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.checkpoints.metadata import CheckpointError
from robogauntlet_mergevla.merging.recipe import Recipe
from robogauntlet_mergevla.network.tokenizer import tokenizer_for
from robogauntlet_mergevla.policies.merged_policy import MergedPolicy
from robogauntlet_mergevla.training.batch_loss import BatchLoss
from robogauntlet_mergevla.training.dataset_mixture import DatasetMixture
from robogauntlet_mergevla.training.finetune import finetune, pretrain
from robogauntlet_mergevla.training.training_checkpoint import TrainingError
from tests.errors import one_line_error
from tests.mergevla.policies.test_merged_policy import Fixed
from tests.mergevla.shared import SMALL
from tests.mergevla.training.test_finetune import LORA, QUICK, dataset, episode
from tests.policies.training.synthetic import write

ONE, TWO = "null/One", "null/Two@TwoPandas"


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A base of both tasks in `base`, and an expert of each in `experts`."""
    folder = tmp_path_factory.mktemp("two-arms")
    recorded = [episode(FIRST_TRAINING_SEED + seed) for seed in range(6)]
    both = [
        replace(one, states=np.tile(one.states, 2), actions=np.tile(one.actions, 2), body=Body(2)) for one in recorded
    ]
    write(folder / "Two", both, per_file=1, task=TWO)
    dataset(folder, "One")
    pretrain(DatasetMixture.open([folder / "One", folder / "Two"]), SMALL, folder / "base", QUICK)
    for name in ("One", "Two"):
        mixture = DatasetMixture.open([folder / name])
        finetune(mixture, folder / "base", folder / "experts" / name, QUICK, lora=LORA)
    return folder


def query(task, arms):
    shown = {camera: np.zeros((16, 16, 3), np.uint8) for camera in CAMERAS}
    observation = Observation(shown, np.zeros(8 * arms), "reach the goal")
    return Query(Episode(task, "p", task, 0, Protocol(8)), 0, observation=observation)


def numbers(policy, queries):
    return [decision.actions.shape[1] for decision in policy.act(queries)]


def test_an_expert_acts_with_the_numbers_of_its_task(trained):
    for name, task, arms in (("One", ONE, 1), ("Two", TWO, 2)):
        policy = catalog.load("mergevla", {"checkpoint": str(trained / "experts" / name)})
        assert policy.spec.action_dim == 7 * arms
        assert numbers(policy, [query(task, arms)]) == [7 * arms]


@pytest.fixture(scope="module")
def merged(trained):
    """The merge of both experts, saved in `merged`."""
    made = merge_experts(read_experts((trained / "experts").iterdir()), Recipe(), {ONE: "reach", TWO: "reach"})
    save_merged(trained / "merged", made, {})
    return made.parts


def test_the_base_experts_by_task_and_their_merge_act_in_both(trained, merged):
    for kind, options in (
        ("mergevla", {"checkpoint": str(trained / "base")}),
        ("mergevla-experts", {"folder": str(trained / "experts")}),
        ("mergevla-merged", {"checkpoint": str(trained / "merged"), "router": "oracle"}),
    ):
        policy = catalog.load(kind, options)
        assert policy.spec.action_dim is None
        assert numbers(policy, [query(ONE, 1), query(TWO, 2)]) == [7, 14]


@pytest.mark.parametrize(("chosen", "task", "arms"), [(TWO, ONE, 1), (ONE, TWO, 2)])
def test_an_expert_of_other_arms_answers_with_the_numbers_of_the_task(merged, chosen, task, arms):
    policy = MergedPolicy(MergedModel(merged), Fixed(chosen))
    (decision,) = policy.act([query(task, arms)])
    assert decision.actions.shape[1] == 7 * arms
    assert not decision.actions[:, 7:].any(), "the second arm does not move"


def test_the_second_arm_of_a_task_of_one_has_no_loss(trained):
    checkpoint = load_checkpoint(trained / "base")
    statistics, architecture = checkpoint.metadata.statistics, checkpoint.model.architecture
    batch_loss = BatchLoss(architecture, statistics, tokenizer_for(architecture), torch.device("cpu"))
    for name, is_learned in (("One", False), ("Two", True)):
        batch = DatasetMixture.open([trained / name]).sample(8, seed=0, step=0, chunk_length=architecture.chunk_length)
        checkpoint.model.zero_grad()
        batch_loss.loss(checkpoint.model, batch).backward()
        gradient = checkpoint.model.action_expert.output.weight.grad
        assert bool(gradient[:7].any())
        assert bool(gradient[7:].any()) is is_learned


def test_demonstrations_of_two_arms_do_not_fit_a_base_of_one(trained, tmp_path):
    pretrain(DatasetMixture.open([trained / "One"]), SMALL, tmp_path / "base", QUICK)
    two = DatasetMixture.open([trained / "Two"])
    with one_line_error(TrainingError, "expected actions of 7 numbers, as the base's, the data has 14"):
        finetune(two, tmp_path / "base", tmp_path / "expert", QUICK, lora=LORA)


def test_statistics_of_more_arms_than_the_network_has_are_refused(trained):
    metadata = load_checkpoint(trained / "experts" / "Two").metadata
    with one_line_error(CheckpointError, "expected statistics of actions of 7 numbers, as the network's, got of 14"):
        replace(metadata, architecture=metadata.architecture.with_numbers(7, 8))

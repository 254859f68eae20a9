"""Networks of two arms, trained like those of one."""

from dataclasses import replace

import numpy as np

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies import catalog
from robogauntlet.policies.contract import Query
from robogauntlet.policies.training.dataset_mixture import DatasetMixture
from robogauntlet.policies.training.finetune import finetune, pretrain
from robogauntlet.policies.training.training_checkpoint import TrainingError
from robogauntlet.suites.episode import CAMERAS, FIRST_TRAINING_SEED, Episode, Protocol
from tests.errors import one_line_error
from tests.policies.mergevla.shared import SMALL
from tests.policies.training.synthetic import write
from tests.policies.training.test_finetune import LORA, QUICK, dataset, episode


def test_networks_of_two_arms_are_trained_and_act_with_twice_the_numbers(tmp_path):
    recorded = [episode(FIRST_TRAINING_SEED + seed) for seed in range(6)]
    both = [replace(one, states=np.tile(one.states, 2), actions=np.tile(one.actions, 2)) for one in recorded]
    write(tmp_path / "Two", both, per_file=1, task="null/Two")
    two = DatasetMixture.open([tmp_path / "Two"])
    base, expert = tmp_path / "base", tmp_path / "expert"
    pretrain(two, SMALL, base, QUICK)
    finetune(two, base, expert, QUICK, lora=LORA)
    policy = catalog.load("mergevla", {"checkpoint": str(expert)})
    assert policy.spec.action_dim == 14
    shown = Observation({camera: np.zeros((16, 16, 3), np.uint8) for camera in CAMERAS}, np.zeros(16), "reach the goal")
    (decision,) = policy.act([Query(Episode("p", "p", "null/Two", 0, Protocol(8)), 0, observation=shown)])
    assert decision.actions.shape[1] == 14
    with one_line_error(TrainingError, "expected actions of 14 numbers, as the base's, the data has 7"):
        finetune(DatasetMixture.open([dataset(tmp_path, "One")]), base, tmp_path / "one", QUICK, lora=LORA)

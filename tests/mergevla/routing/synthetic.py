"""A merged model of small random networks, and first observations without a simulator."""

from types import SimpleNamespace

import numpy as np
import torch

from robogauntlet_mergevla.network.normalisation import TaskStatistics
from robogauntlet_mergevla.network.tokenizer import tokenizer_for
from robogauntlet_mergevla.routing.contract import FirstObservation
from robogauntlet_mergevla.routing.features import LabelledFeatures
from tests.mergevla.shared import INSTRUCTIONS, SMALL, small_model, some_statistics

EXPERTS = ("null/Push", "null/Open", "null/Reach")


class SmallMergedModel:
    """Networks that share nothing; each expert's seed is its own, so that the order of experts changes no weight."""

    architecture = SMALL

    def __init__(self, experts=EXPERTS, kept_blocks=1):
        self.experts, self.kept_blocks = tuple(experts), kept_blocks
        self.tasks = {e: (e,) for e in self.experts}
        self.expert_of = {e: e for e in self.experts}
        self.instructions = {e: INSTRUCTIONS[EXPERTS.index(e)] for e in experts}
        self.models = {None: small_model(0)} | {e: small_model(1 + EXPERTS.index(e)) for e in experts}
        self.own = {e: small_model(11 + EXPERTS.index(e)) for e in experts}
        self.parts = SimpleNamespace(statistics=TaskStatistics({e: some_statistics() for e in experts}))
        self.device = torch.device("cpu")
        self.passes = []
        self.factorised = 0

    def hidden_states(self, expert, images, instructions):
        self.passes.append(expert)
        return self.models[expert].hidden_states(images, tokenizer_for(SMALL)(instructions))

    def model(self, expert):
        return self.models[expert]

    def weights(self, expert):
        return self.models[expert].state_dict()

    def projections(self, expert, block):
        self.factorised += 1
        layer = self.models[expert].action_expert.blocks[block]
        return {name: getattr(layer, name).weight for name in ("k_adapter", "k_task", "v_adapter", "v_task")}

    def own_value_weights(self, expert):
        self.factorised += 1
        blocks = self.own[expert].action_expert.blocks
        return values(blocks[len(blocks) - self.kept_blocks - 1])


def values(block):
    return block.v_adapter.weight, block.v_task.weight


def observation(seed, task=None, instruction=None):
    """Frames of a task share a pattern, with noise."""
    generator = torch.Generator().manual_seed(seed)
    index = seed % len(EXPERTS) if task is None else EXPERTS.index(task)
    pattern = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(1000 + index))
    noise = torch.rand(2, 3, 16, 16, generator=generator)
    return FirstObservation(
        images=0.8 * pattern + 0.2 * noise,
        instruction=INSTRUCTIONS[index] if instruction is None else instruction,
        proprioception=np.zeros(8),
        episode_id=f"{seed:016x}",
        task=EXPERTS[index],
    )


def observations(count=7):
    return [observation(seed) for seed in range(count)]


def frames(first, count, experts=EXPERTS):
    return {e: [observation(first + 100 * i, e) for i in range(count)] for e in experts}


def gaussians(seed, count=40, classes=("a", "b", "c", "d"), dim=12, apart=8.0, spread=1.0):
    """Classes around different centres, the same for every seed."""
    generator = np.random.default_rng(seed)
    labels = tuple(name for name in classes for _ in range(count))
    centres = {name: np.random.default_rng([7, ord(name)]).normal(size=dim) * apart / np.sqrt(2) for name in classes}
    noise = generator.normal(size=(len(labels), dim)) * spread
    return LabelledFeatures(torch.tensor(np.array([centres[name] for name in labels]) + noise).float(), labels)

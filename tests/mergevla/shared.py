"""Small networks and inputs that several tests share."""

from dataclasses import replace

import numpy as np
import torch

from robogauntlet.adapters.contract import Observation
from robogauntlet.policies.contract import Query
from robogauntlet.suites.episode import Episode, Protocol
from robogauntlet_mergevla.network.config import TINY, ConvStem, ExpertConfig, LanguageModel, PaperCodeQuirks
from robogauntlet_mergevla.network.model import build
from robogauntlet_mergevla.network.normalisation import Statistics, TaskStatistics
from robogauntlet_mergevla.network.tokenizer import tokenizer_for

SMALL = replace(
    TINY,
    name="small",
    image_size=16,
    vision=ConvStem((8, 16)),
    projector=(16,),
    language=LanguageModel(16, layers=2, heads=2, key_value_heads=1, feed_forward=32, vocabulary=64),
    action_queries=3,
    expert=ExpertConfig(heads=2),
    prompt_tokens=8,
)
INSTRUCTIONS = ("push the cube", "open the door with the handle", "reach", "stack")


def small_model(seed=0, **changes):
    return build(replace(SMALL, **changes), seed).eval()


def with_quirk(name):
    return {"quirks": PaperCodeQuirks(**{name: True})}


def inputs(architecture, batch=4, seed=0):
    generator = torch.Generator().manual_seed(seed)
    size = architecture.image_size
    images = torch.rand(batch, len(architecture.cameras), 3, size, size, generator=generator)
    prompts = tokenizer_for(architecture)([INSTRUCTIONS[i % len(INSTRUCTIONS)] for i in range(batch)])
    return images, prompts, torch.rand(batch, 8, generator=generator) * 2 - 1


def some_statistics(seed=0):
    generator = np.random.default_rng(seed)
    return Statistics.of(generator.normal(size=(50, 7)), generator.normal(size=(50, 8)))


def task_statistics(seed=0, task="null/Reach"):
    return TaskStatistics({task: some_statistics(seed)})


def query(seed, size=SMALL.image_size, instruction=None, task="null/Reach"):
    generator = np.random.default_rng(seed)
    images = {
        camera: generator.integers(0, 256, (size, size, 3)).astype(np.uint8) for camera in ("third_person", "wrist")
    }
    words = instruction or INSTRUCTIONS[seed % len(INSTRUCTIONS)]
    episode = Episode("p", "p", task, seed, Protocol(40))
    return Query(episode, 0, Observation(images, generator.normal(size=8), words))

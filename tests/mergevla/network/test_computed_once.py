"""Answers with angles that are computed once equal those that compute them in every layer, to the bit."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from robogauntlet_mergevla.checkpoints.merged_model import MergedModel
from robogauntlet_mergevla.kinds import KIND
from robogauntlet_mergevla.network import action_expert
from robogauntlet_mergevla.network.action_expert import ROPE_BASE
from robogauntlet_mergevla.network.config import TINY, ExpertConfig
from robogauntlet_mergevla.network.model import build
from robogauntlet_mergevla.policies.merged_policy import MergedPolicy
from robogauntlet_mergevla.routing.catalog import router
from tests.mergevla.experts import TASKS, merging, save_experts
from tests.mergevla.shared import SMALL, inputs, query, with_quirk


def rotated_plainly(states, *, interleaved=False):
    count, dim = states.shape[-2:]
    frequencies = ROPE_BASE ** (-torch.arange(0, dim, 2, dtype=torch.float32, device=states.device) / dim)
    angles = torch.arange(count, dtype=torch.float32, device=states.device)[:, None] * frequencies
    angles = torch.cat([angles, angles], dim=-1)
    if interleaved:
        turned = torch.stack([-states[..., 1::2], states[..., ::2]], dim=-1).flatten(-2)
    else:
        turned = torch.cat([-states[..., dim // 2 :], states[..., : dim // 2]], dim=-1)
    return states * angles.cos() + turned * angles.sin()


@pytest.fixture
def plainly(monkeypatch):
    """Call a function with the plain definition."""

    def call(function):
        with monkeypatch.context() as patched:
            patched.setattr(action_expert, "rotate", rotated_plainly)
            patched.setattr(action_expert, "step_encoding", action_expert.step_encoding.__wrapped__)
            return function()

    return call


VARIANTS = {
    "tiny": TINY,
    "self-attention": replace(SMALL, expert=ExpertConfig(heads=2, self_attention=True)),
    "paper's rope": replace(SMALL, **with_quirk("interleaved_rope")),
}


@pytest.mark.parametrize("batch", [1, 5])
@pytest.mark.parametrize("name", VARIANTS)
def test_chunks_equal_those_of_the_plain_definition(name, batch, plainly):
    model, given = build(VARIANTS[name], 0).eval(), inputs(VARIANTS[name], batch)
    with torch.inference_mode():
        assert torch.equal(model(*given), plainly(lambda: model(*given)))


def test_angles_of_an_answer_serve_training_afterwards():
    for function in (action_expert._rotation, action_expert.step_encoding):
        function.cache_clear()
    model, given = build(SMALL, 0), inputs(SMALL)
    with torch.inference_mode():
        model(*given)
    model(*given).sum().backward()


@pytest.fixture(scope="module")
def experts(tmp_path_factory):
    return save_experts(tmp_path_factory.mktemp("experts"))


@pytest.mark.parametrize("batch", [1, 7])
@pytest.mark.parametrize("name", ["expert", "oracle", "paper-coded"])
def test_policies_answer_as_by_the_plain_definition(name, batch, experts, plainly):
    def answers():
        policy = (
            KIND.load({"checkpoint": str(experts[0])})
            if name == "expert"
            else MergedPolicy(MergedModel(merging(experts).parts), router(name))
        )
        queries = [query(seed, task=TASKS[seed % len(TASKS)]) for seed in range(batch)]
        policy.reset([asked.episode for asked in queries])
        return [decision.actions for decision in [*policy.act(queries), *policy.act(queries)]]

    for quick, plain in zip(answers(), plainly(answers), strict=True):
        np.testing.assert_array_equal(quick, plain)

"""Where the networks of the three kinds compute."""

import numpy as np
import pytest
import torch

from robogauntlet.policies.contract import PolicyError
from robogauntlet.policies.mergevla.checkpoints.merged_checkpoint import save_merged
from robogauntlet.policies.mergevla.kinds import EXPERTS, KIND, MERGED
from tests.policies.mergevla.experts import TASKS, merging, save_experts
from tests.policies.mergevla.shared import query

KINDS = [KIND, EXPERTS, MERGED]


@pytest.fixture(scope="module")
def options(tmp_path_factory):
    """The options of each kind."""
    folder = tmp_path_factory.mktemp("device")
    folders = save_experts(folder)
    save_merged(folder / "merged", merging(folders), {})
    return {
        KIND.name: {"checkpoint": str(folders[0])},
        EXPERTS.name: {"folder": str(folders[0].parent)},
        MERGED.name: {"checkpoint": str(folder / "merged"), "router": "oracle"},
    }


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
@pytest.mark.parametrize("device", ["gpu", "cuda:", "cpu:1", "", 0])
def test_other_devices_are_refused_before_anything_is_loaded(kind, device, options):
    with pytest.raises(PolicyError, match="expected option device: cpu, cuda or cuda:N; by default the GPU"):
        kind.digest({**options[kind.name], "device": device})


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_the_device_is_no_part_of_the_policy(kind, options):
    assert kind.digest({**options[kind.name], "device": "cpu"}) == kind.digest(options[kind.name])


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_gpu_that_is_not_there_is_refused(kind, options):
    there = torch.cuda.device_count()
    with pytest.raises(PolicyError, match=f"expected one of {there} GPUs? that torch .* finds, got cuda:{there}"):
        kind.load({**options[kind.name], "device": f"cuda:{there}"})


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_gpu_answers_as_the_cpu_does(kind, options):
    asked = [query(number, task=TASKS[0]) for number in range(3)]
    cpu, gpu = (kind.load({**options[kind.name], "device": device}).act(asked) for device in ("cpu", "cuda"))
    for ours, theirs in zip(cpu, gpu, strict=True):
        np.testing.assert_allclose(ours.actions, theirs.actions, atol=1e-3)

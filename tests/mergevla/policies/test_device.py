"""Where the networks of the three kinds compute."""

import numpy as np
import pytest
import torch

from robogauntlet.policies.contract import PolicyError
from robogauntlet_mergevla.checkpoints.merged_checkpoint import save_merged
from robogauntlet_mergevla.kinds import EXPERTS, KIND, MERGED
from robogauntlet_mergevla.policies.single_policy import device_named
from tests.mergevla.experts import TASKS, merging, save_experts
from tests.mergevla.shared import query

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
@pytest.mark.parametrize(
    "device", ["gpu", "cuda:", "cuda:01", "cuda:256", "cuda:\N{ARABIC-INDIC DIGIT ONE}", "cpu:1", "", 0]
)
def test_other_devices_are_refused_before_anything_is_loaded(kind, device, options):
    with pytest.raises(PolicyError, match="expected option device: cpu, cuda or cuda:N; by default cpu, got"):
        kind.digest({**options[kind.name], "device": device})


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_gpu_makes_another_policy_because_it_rounds_differently(kind, options):
    on = {device: kind.digest({**options[kind.name], "device": device}) for device in ("cpu", "cuda", "cuda:1")}
    assert on["cpu"] == kind.digest(options[kind.name])
    assert on["cuda"] == on["cuda:1"] != on["cpu"]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_suite_can_be_planned_where_no_gpu_is(kind, options):
    assert kind.spec({**options[kind.name], "device": "cuda:99"}) == kind.load(options[kind.name]).spec


def test_a_gpu_that_torch_cannot_use_is_not_there(monkeypatch):
    """As with a driver that is too old for torch: the driver's library still counts the GPU."""
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(PolicyError, match="expected one of 0 GPUs"):
        device_named("cuda")


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_gpu_that_is_not_there_is_refused(kind, options):
    there = torch.cuda.device_count() if torch.cuda.is_available() else 0
    with pytest.raises(PolicyError, match=f"expected one of {there} GPUs? that torch .* finds, got cuda:{there}"):
        kind.load({**options[kind.name], "device": f"cuda:{there}"})


@pytest.mark.skipif(not torch.cuda.is_available(), reason="this machine has no GPU")
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_gpu_answers_as_the_cpu_does(kind, options):
    asked = [query(number, task=TASKS[0]) for number in range(3)]
    cpu, gpu = (kind.load({**options[kind.name], "device": device}).act(asked) for device in ("cpu", "cuda"))
    for ours, theirs in zip(cpu, gpu, strict=True):
        np.testing.assert_allclose(ours.actions, theirs.actions, atol=1e-3)

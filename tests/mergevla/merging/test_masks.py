"""The mask rule, packed masks, and error messages."""

import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from robogauntlet_mergevla.merging.elementwise import task_arithmetic
from robogauntlet_mergevla.merging.errors import ExpertsDiffer, OutOfRange
from robogauntlet_mergevla.merging.masks import (
    MaskMismatch,
    lambdas_of,
    masked,
    pack_mask,
    packed_bytes,
    task_mask,
    task_masks,
    unpack_mask,
)
from tests.errors import one_line_error
from tests.mergevla.merging.strategies import copied, equal, random_task_vectors, task_vectors

lambdas = st.floats(0, 2, exclude_min=True)
shapes = st.lists(st.integers(0, 9), max_size=4).map(tuple)


@st.composite
def masks(draw):
    size = draw(shapes)
    entries = torch.Size(size).numel()
    bits = draw(st.lists(st.booleans(), min_size=entries, max_size=entries) if entries < 300 else st.none())
    flat = torch.arange(entries) % 3 == 0 if bits is None else torch.tensor(bits, dtype=torch.bool)
    return flat.reshape(size)


def vector(*entries):
    return {"w": torch.tensor(entries, dtype=torch.float32)}


def test_the_mask_rule_has_known_values():
    own, merged = vector(1, 1, -1, 0, 0, 3), vector(2.5, 3, 1, 0, 5, 3)
    # 0.6 |tau_merge - tau|: 0.9, 1.2, 1.2, 0, 3, 0.
    assert task_mask(own, merged)["w"].tolist() == [True, False, False, False, False, True]
    assert task_mask(own, merged, 0.5)["w"].tolist() == [True, False, False, False, False, True]  # 1 > 1 is not
    assert task_mask(own, merged, 0.49)["w"].tolist() == [True, True, True, False, False, True]


def test_a_masked_vector_is_the_merged_one_where_the_mask_keeps_it_and_zero_elsewhere():
    merged = vector(1, 2)
    assert masked(merged, {"w": torch.tensor([True, False])})["w"].tolist() == [1, 0]
    assert merged["w"].tolist() == [1, 2]


@settings(max_examples=50)
@given(experts=task_vectors(grid=True))
def test_a_vanishing_lambda_keeps_everything_that_a_task_changed_and_nothing_else(experts):
    for expert, mask in task_masks(experts, task_arithmetic(experts), 1e-9).items():
        assert all(torch.equal(mask[name], experts[expert][name] != 0) for name in mask)


@settings(max_examples=50)
@given(experts=task_vectors(), one=lambdas, other=lambdas)
def test_masks_shrink_as_lambda_grows(experts, one, other):
    merged = task_arithmetic(experts)
    low, high = (task_masks(experts, merged, value) for value in sorted((one, other)))
    for expert in experts:
        assert all(torch.all(high[expert][name] <= low[expert][name]) for name in merged)


@settings(max_examples=25)
@given(experts=task_vectors(max_experts=1), value=lambdas)
def test_a_single_expert_is_fully_kept(experts, value):
    merged = task_arithmetic(experts)
    mask = task_masks(experts, merged, value)["expert0"]
    assert equal(masked(merged, mask), experts["expert0"])


def test_each_task_may_have_its_own_lambda():
    experts = random_task_vectors(2)
    merged = task_arithmetic(experts)
    both = task_masks(experts, merged, {"expert0": 0.2, "expert1": 1.5})
    assert equal(both["expert0"], task_mask(experts["expert0"], merged, 0.2))
    assert equal(both["expert1"], task_mask(experts["expert1"], merged, 1.5))


def test_masks_do_not_change_their_arguments():
    experts = random_task_vectors(2)
    merged = task_arithmetic(experts)
    before = copied({**experts, "merged": merged})
    made = task_masks(experts, merged)
    masked(merged, made["expert0"])
    assert all(equal(before[name], vector) for name, vector in {**experts, "merged": merged}.items())


@settings(max_examples=100)
@given(mask=st.dictionaries(st.text("ab./", min_size=1), masks(), max_size=3))
def test_a_packed_mask_unpacks_to_itself(mask):
    packed = pack_mask(mask)
    assert equal(unpack_mask(packed), mask)
    for name, kept in mask.items():
        assert packed[f"bits/{name}"].dtype == torch.uint8
        assert packed[f"bits/{name}"].numel() == packed_bytes(kept.numel())


def test_a_packed_mask_can_be_stored_as_safetensors():
    from safetensors.torch import load, save

    mask = task_mask(*random_task_vectors(2, shape=(13, 7)).values())
    assert equal(unpack_mask(load(save(pack_mask(mask)))), mask)


@pytest.mark.parametrize("value", [0.0, -0.1, 2.001, math.nan, math.inf, "0.6"])
def test_a_lambda_outside_0_to_2_is_refused(value):
    with pytest.raises(OutOfRange, match=r"expected lambda to be a number in \(0, 2\], got"):
        task_mask(vector(1), vector(1), value)
    with pytest.raises(OutOfRange):
        lambdas_of({"a": vector(1)}, {"a": value})


def test_lambdas_of_other_experts_are_refused():
    with pytest.raises(ExpertsDiffer, match="b is in one of them only"):
        lambdas_of({"a": vector(1)}, {"a": 0.6, "b": 0.6})


@pytest.mark.parametrize(
    ("mask", "message"),
    [
        ({}, "weight w is missing"),
        ({"w": torch.ones(3, dtype=torch.bool)}, r"weight w: expected shape \(2,\), got \(3,\)"),
        ({"w": torch.ones(2, dtype=torch.bool), "v": torch.ones(1, dtype=torch.bool)}, "weight v is unexpected"),
        ({"w": torch.ones(2)}, "expected torch.bool, got torch.float32"),
    ],
)
def test_a_mask_for_another_model_is_refused_in_one_line(mask, message):
    with one_line_error(MaskMismatch, message):
        masked(vector(1, 2), mask)


def damage(**parts):
    sound = pack_mask({"w": torch.tensor([True, False, True])})
    return {name: tensor for name, tensor in {**sound, **parts}.items() if tensor is not None}


@pytest.mark.parametrize(
    ("packed", "message"),
    [
        (damage(**{"bits/w": None}), "expected bits and shape for each weight, w has one"),
        (damage(**{"bits/w": torch.zeros(2, dtype=torch.uint8)}), r"expected 1 bytes for \(3,\), got 2"),
        (damage(**{"bits/w": torch.zeros(1)}), "expected flat uint8 bits"),
        (damage(**{"bits/w": torch.tensor([255], dtype=torch.uint8)}), "expected zeros after its 3 entries"),
        (damage(**{"shape/w": torch.tensor([-1])}), r"expected a shape, got \(-1,\)"),
        (damage(w=torch.zeros(1)), "expected tensors named bits/... and shape/..."),
    ],
)
def test_a_damaged_packed_mask_is_refused(packed, message):
    with pytest.raises(MaskMismatch, match=message):
        unpack_mask(packed)

"""Weights with a few bits per entry."""

import pytest
import torch
from hypothesis import given, settings, strategies as st

from robogauntlet_mergevla.merging.errors import ExpertsDiffer, OutOfRange
from robogauntlet_mergevla.merging.quantisation import CODES, SCALES, pack, quantise, unpack
from robogauntlet_mergevla.merging.recipe import Recipe
from tests.errors import one_line_error

BITS = st.integers(2, 8)


@st.composite
def matrices(draw):
    shape = draw(st.tuples(st.integers(0, 5), st.integers(0, 9)))
    generator = torch.Generator().manual_seed(draw(st.integers(0, 2**31)))
    return torch.randn(shape, generator=generator) * draw(st.sampled_from([0.0, 1e-6, 1e-2, 10.0]))


@settings(max_examples=60)
@given(weight=matrices(), bits=BITS)
def test_packed_weights_are_unpacked_unchanged_and_take_their_bits(weight, bits):
    made = quantise(weight, bits)
    packed = pack({"w": made}, bits)
    back = unpack(packed, "w", weight.shape[1], bits)
    assert torch.equal(back.codes, made.codes)
    assert torch.equal(back.dequantised(), made.dequantised())
    assert packed[CODES + "w"].numel() == -(-weight.numel() * bits // 8)
    assert packed[SCALES + "w"].numel() == len(weight)


@settings(max_examples=60)
@given(weight=matrices(), bits=BITS)
def test_no_scale_of_rounding_to_the_largest_magnitude_is_better(weight, bits):
    made = quantise(weight, bits).dequantised()
    most = 2 ** (bits - 1) - 1
    for row, own in zip(weight, made, strict=True):
        if not row.numel() or not row.any():
            assert not own.any()
            continue
        scale = (row.abs().max() / most).bfloat16().float()
        plain = (row / scale).round().clamp(-most, most) * scale
        assert (own - row).norm() <= (plain - row).norm() * (1 + 1e-5)


def test_the_error_falls_with_every_bit():
    weight = torch.randn(64, 128, generator=torch.Generator().manual_seed(0))
    errors = [(quantise(weight, bits).dequantised() - weight).norm() / weight.norm() for bits in range(2, 9)]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] < 0.6
    assert errors[-1] < 0.01


def test_known_values_with_three_bits():
    made = quantise(torch.tensor([[3.0, -2.0, 1.0, 0.0], [6.0, -6.0, 2.0, 0.0]]), 3)
    assert made.codes.tolist() == [[3, -2, 1, 0], [3, -3, 1, 0]]
    assert made.scales.tolist() == [1.0, 2.0]


def test_a_vector_and_a_number_are_one_row_and_a_convolution_has_its_outputs_as_rows():
    shapes = {(5,): (1, 5), (): (1, 1), (4, 3, 2, 2): (4, 12)}
    assert {shape: tuple(quantise(torch.ones(shape), 4).codes.shape) for shape in shapes} == shapes


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda packed: packed.pop(CODES + "w"), "got no codes"),
        (lambda packed: packed.pop(SCALES + "w"), "got no scales"),
        (lambda packed: packed.update({CODES + "w": packed[CODES + "w"][:-1]}), "expected 4 bits for each entry of w"),
        (lambda packed: packed.update({CODES + "w": packed[CODES + "w"].float()}), "expected 4 bits"),
        (lambda packed: packed.update({SCALES + "w": packed[SCALES + "w"].float()}), "expected 4 bits"),
        (lambda packed: packed.update({SCALES + "w": packed[SCALES + "w"][None]}), "expected 4 bits"),
    ],
)
def test_damaged_tensors_are_one_line(change, match):
    packed = pack({"w": quantise(torch.ones(3, 5), 4)}, 4)
    change(packed)
    with one_line_error(ExpertsDiffer, match):
        unpack(packed, "w", 5, 4)


@pytest.mark.parametrize("bits", [None, 1, 9, 4.0, True, "4"])
def test_bits_out_of_range_are_refused(bits):
    with one_line_error(OutOfRange, r"expected bits to be a whole number in \[2, 8\], got"):
        Recipe("none", masks="none", options={} if bits is None else {"bits": bits})


def test_masks_of_what_is_not_merged_are_refused():
    with one_line_error(OutOfRange, "expected masks 'none' where nothing is merged, got 'task'"):
        Recipe("none", options={"bits": 4})

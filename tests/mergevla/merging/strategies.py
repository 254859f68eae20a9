"""Task vectors for property tests."""

import torch
from hypothesis import strategies as st

NAMES = ("block.weight", "block.bias", "gate", "empty")
SHAPES = {"block.weight": (3, 4), "block.bias": (5,), "gate": (), "empty": (0,)}
entries = st.floats(-4.0, 4.0, width=32, allow_subnormal=False)


@st.composite
def task_vectors(draw, min_experts=1, max_experts=4, grid=False):
    """Task vectors of a matrix, a vector, a scalar and an empty weight.

    `grid` draws multiples of 1/8 up to 2, so that zeros, ties and exact cancellation are common.
    """
    experts = draw(st.integers(min_experts, max_experts))
    values = st.integers(-16, 16).map(lambda n: n / 8) if grid else entries
    return {
        f"expert{i}": {
            name: torch.tensor(draw(st.lists(values, min_size=size, max_size=size)), dtype=torch.float32).reshape(shape)
            for name, shape in SHAPES.items()
            for size in [torch.Size(shape).numel()]
        }
        for i in range(experts)
    }


def random_task_vectors(experts, shape=(6, 8), seed=0, scale=1.0):
    """Gaussian task vectors of a matrix `w` and a vector `b`."""
    generator = torch.Generator().manual_seed(seed)
    return {
        f"expert{i}": {
            "w": torch.randn(shape, generator=generator) * scale,
            "b": torch.randn(shape[0], generator=generator) * scale,
        }
        for i in range(experts)
    }


def copied(task_vectors):
    return {expert: {name: delta.clone() for name, delta in vector.items()} for expert, vector in task_vectors.items()}


def equal(a, b):
    """Same names, types, shapes and values."""
    return a.keys() == b.keys() and all(a[n].dtype == b[n].dtype and torch.equal(a[n], b[n]) for n in a)


def close(a, b, tolerance=1e-5):
    return a.keys() == b.keys() and all(torch.allclose(a[n], b[n], rtol=tolerance, atol=tolerance) for n in a)

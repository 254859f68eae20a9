"""Names and numbers as tensors, so that a safetensors file can hold a fitted router."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from robogauntlet.policies.mergevla.routing.contract import RoutingError


def encode_names(names: Sequence[str]) -> Tensor:
    """Return names as the bytes of their lines; `decode_names` is the inverse."""
    return torch.tensor(list("\n".join(names).encode()), dtype=torch.uint8)


def decode_names(tensors: Mapping[str, Tensor], name: str) -> tuple[str, ...]:
    """Read names that `encode_names` wrote.

    Raises:
        RoutingError: They are missing or malformed.
    """
    tensor = tensors.get(name)
    if tensor is None or tensor.dtype != torch.uint8 or tensor.ndim != 1 or len(tensor) == 0:
        raise RoutingError(f"expected {name} as the bytes of their names, got {_described(tensor)}")
    try:
        return tuple(bytes(tensor.tolist()).decode().split("\n"))
    except UnicodeDecodeError:
        raise RoutingError(f"expected {name} as names in UTF-8, got other bytes") from None


def read_tensor(tensors: Mapping[str, Tensor], name: str, shape: tuple[int | None, ...]) -> Tensor:
    """Read a tensor of that name and shape, in which None stands for any length.

    Raises:
        RoutingError: It is missing, has another shape, or is not finite.
    """
    tensor = tensors.get(name)
    fits = tensor is not None and tensor.ndim == len(shape) and tensor.is_floating_point()
    if tensor is None or not fits or any(n not in (None, got) for n, got in zip(shape, tensor.shape, strict=True)):
        expected = ", ".join("any" if length is None else str(length) for length in shape)
        raise RoutingError(f"expected {name} as numbers of shape ({expected}), got {_described(tensor)}")
    if not torch.isfinite(tensor).all():
        raise RoutingError(f"expected a finite {name}, got NaN or infinity")
    return tensor


def read_number(tensors: Mapping[str, Tensor], name: str) -> float:
    """Read a number; raises RoutingError as `read_tensor` does."""
    return float(read_tensor(tensors, name, ()))


def _described(tensor: Tensor | None) -> str:
    return "none" if tensor is None else f"{tuple(tensor.shape)} of {tensor.dtype}"

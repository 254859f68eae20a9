"""Names and numbers as tensors, so that a fitted router fits into a safetensors file whole."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from policies.mergevla.routing.contract import RoutingError


def names_tensor(names: Sequence[str]) -> Tensor:
    """Names as the bytes of their lines; `names_from` is the inverse."""
    return torch.tensor(list("\n".join(names).encode()), dtype=torch.uint8)


def names_from(tensors: Mapping[str, Tensor], name: str) -> tuple[str, ...]:
    """Names that `names_tensor` wrote.

    Raises:
        RoutingError: There are none, or they do not read.
    """
    came = tensors.get(name)
    if came is None or came.dtype != torch.uint8 or came.ndim != 1 or len(came) == 0:
        raise RoutingError(f"expected {name} as the bytes of their names, got {_described(came)}")
    try:
        return tuple(bytes(came.tolist()).decode().split("\n"))
    except UnicodeDecodeError:
        raise RoutingError(f"expected {name} as names in UTF-8, got other bytes") from None


def tensor_from(tensors: Mapping[str, Tensor], name: str, shape: tuple[int | None, ...]) -> Tensor:
    """A tensor of that name and shape, None for any length.

    Raises:
        RoutingError: There is none, it has another shape, or it is not finite.
    """
    came = tensors.get(name)
    fits = came is not None and came.ndim == len(shape) and came.is_floating_point()
    if came is None or not fits or any(want not in (None, got) for want, got in zip(shape, came.shape, strict=True)):
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise RoutingError(f"expected {name} as numbers of shape ({wanted}), got {_described(came)}")
    if not torch.isfinite(came).all():
        raise RoutingError(f"expected a finite {name}, got NaN or infinity")
    return came


def number_from(tensors: Mapping[str, Tensor], name: str) -> float:
    """A number of that name.

    Raises:
        RoutingError: There is none, or it is not finite.
    """
    return float(tensor_from(tensors, name, ()))


def _described(came: Tensor | None) -> str:
    return "none" if came is None else f"{tuple(came.shape)} of {came.dtype}"

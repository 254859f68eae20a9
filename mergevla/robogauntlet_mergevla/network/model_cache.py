"""Networks in memory: as many as fit."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

import torch
from torch import Tensor

from robogauntlet.support.memory import available_memory

Key = TypeVar("Key")
Network = TypeVar("Network")
SHARE = 0.5
"""Largest share of the memory that was free at first which networks take."""


class ModelCache(Generic[Key, Network]):
    """Builds the network of each key on first use, and drops those least recently used when memory runs short.

    The limit is memory, not a number, so that small networks of any number of experts stay: a router that asks for one
    after the other would otherwise build each again for every observation.
    """

    def __init__(
        self,
        build: Callable[[Key], Network],
        tensors_of: Callable[[Network], Iterable[Tensor]],
        *,
        device: torch.device,
        shared: Iterable[Tensor] = (),
        limit: int | None = None,
    ) -> None:
        """Build networks by `build`.

        Args:
            build: Returns the network of a key.
            tensors_of: Returns a network's tensors.
            device: Where the networks are.
            shared: Tensors that the networks share with others, which take no further memory.
            limit: Memory of all networks (bytes), by default half of what is free on the device.
        """
        self._build, self._tensors_of = build, tensors_of
        self._shared = {tensor.data_ptr() for tensor in shared}
        self._limit = int(SHARE * _free(device)) if limit is None else limit
        self._networks: OrderedDict[Key, tuple[Network, int]] = OrderedDict()

    def __call__(self, key: Key) -> Network:
        """Return the network of a key."""
        if key not in self._networks:
            self._make_room()
            network = self._build(key)
            self._networks[key] = network, self._size(network)
        self._networks.move_to_end(key)
        return self._networks[key][0]

    def _make_room(self) -> None:
        """Drop networks until one more fits that is as large as the largest."""
        while self._networks:
            sizes = [size for _, size in self._networks.values()]
            if sum(sizes) + max(sizes) <= self._limit:
                return
            self._networks.popitem(last=False)

    def _size(self, network: Network) -> int:
        own = (tensor for tensor in self._tensors_of(network) if tensor.data_ptr() not in self._shared)
        return sum(tensor.numel() * tensor.element_size() for tensor in own)


def _free(device: torch.device) -> int:
    """Free memory of a device (bytes)."""
    return torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else available_memory()

"""Servers of openpi's protocol as a kind of policy. Light: what talks to them is imported when it is needed.

The protocol is that of https://github.com/Physical-Intelligence/openpi (Apache 2.0): the server sends metadata on
connection, then answers each observation with a chunk, both msgpack; a text frame is an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from typing import TYPE_CHECKING, Any

from policies.contract import Policy, PolicyError, PolicyKind, PolicySpec
from policies.remote.card import NAME, OPTIONS, read_card

if TYPE_CHECKING:
    from policies.remote.acting import RemotePolicy


def _remote(options: Mapping[str, Any]) -> RemotePolicy:
    card = read_card(options)
    try:
        from policies.remote.acting import RemotePolicy
    except ModuleNotFoundError as error:
        raise PolicyError(
            f"policy '{NAME}': expected the packages of robogauntlet[remote], found none named {error.name}"
        ) from None
    return RemotePolicy(card)


def _load(options: Mapping[str, Any]) -> Policy:
    return _remote(options)


def _digest(options: Mapping[str, Any]) -> str:
    with closing(_remote(options)) as policy:
        return policy.digest()


def _spec(options: Mapping[str, Any]) -> PolicySpec:
    with closing(_remote(options)) as policy:
        return policy.spec


KIND = PolicyKind(
    name=NAME,
    summary="a policy behind a websocket, in openpi's protocol",
    load=_load,
    digest=_digest,
    spec=_spec,
    options=OPTIONS,
)

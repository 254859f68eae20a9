"""The policy kind `openpi`. Light: the websocket client is imported on first use.

The protocol is that of https://github.com/Physical-Intelligence/openpi (Apache 2.0): the server sends metadata on
connection, then answers each observation with a chunk, both as msgpack; a text frame is an error.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing
from typing import TYPE_CHECKING, Any

from robogauntlet.policies.contract import Contact, PolicyKind, PolicyNotInstalled, PolicySpec, Wishes
from robogauntlet.policies.remote.server_options import NAME, OPTIONS, read_options

if TYPE_CHECKING:
    from robogauntlet.policies.remote.remote_policy import RemotePolicy


def _load(options: Mapping[str, Any]) -> RemotePolicy:
    server_options = read_options(options)
    try:
        from robogauntlet.policies.remote.remote_policy import RemotePolicy
    except ModuleNotFoundError as error:
        raise PolicyNotInstalled(
            f"policy '{NAME}': not installed (no module {error.name}); install it: pip install websockets msgpack"
        ) from None
    return RemotePolicy(server_options)


def _digest(options: Mapping[str, Any]) -> str:
    with closing(_load(options)) as policy:
        return policy.digest()


def _digest_by_identity(options: Mapping[str, Any]) -> str | None:
    server_options = read_options(options)
    return None if server_options.identity is None else server_options.digest({"identity": server_options.identity})


def _spec(options: Mapping[str, Any]) -> PolicySpec:
    with closing(_load(options)) as policy:
        return policy.spec


def _contact(options: Mapping[str, Any]) -> Contact:
    with closing(_load(options)) as policy:
        return policy.contact(options)


def _wishes(options: Mapping[str, Any]) -> Wishes:
    return read_options(options).wishes


KIND = PolicyKind(
    name=NAME,
    summary="a policy behind a websocket, in openpi's protocol",
    load=_load,
    digest=_digest,
    digest_without_start=_digest_by_identity,
    spec=_spec,
    wishes=_wishes,
    contact=_contact,
    options=OPTIONS,
)

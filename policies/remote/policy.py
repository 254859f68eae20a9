"""The policy kinds behind a server, one for each protocol. Light: the websocket client is imported on first use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from typing import TYPE_CHECKING, Any

from robogauntlet.policies.contract import Contact, PolicyKind, PolicyNotInstalled, PolicySpec, Wishes
from robogauntlet.policies.remote.server_options import ServerOptions, VlaEvalOptions, options_of, read_options

if TYPE_CHECKING:
    from robogauntlet.policies.remote.openpi import OpenpiPolicy
    from robogauntlet.policies.remote.vla_eval import VlaEvalPolicy

    ServerPolicy = OpenpiPolicy | VlaEvalPolicy


def _openpi(options: ServerOptions) -> OpenpiPolicy:
    from robogauntlet.policies.remote.openpi import OpenpiPolicy

    return OpenpiPolicy(options)


def _vla_eval(options: ServerOptions) -> VlaEvalPolicy:
    from robogauntlet.policies.remote.vla_eval import VlaEvalPolicy

    return VlaEvalPolicy(options)


def _kind(kind: type[ServerOptions], summary: str, connect: Callable[[ServerOptions], ServerPolicy]) -> PolicyKind:
    name = kind.PROTOCOL

    def load(options: Mapping[str, Any]) -> ServerPolicy:
        server_options = read_options(options, kind)
        try:
            return connect(server_options)
        except ModuleNotFoundError as error:
            raise PolicyNotInstalled(
                f"policy '{name}': not installed (no module {error.name}); install it: pip install websockets msgpack"
            ) from None

    def digest(options: Mapping[str, Any]) -> str:
        with closing(load(options)) as policy:
            return policy.digest()

    def digest_by_identity(options: Mapping[str, Any]) -> str | None:
        server_options = read_options(options, kind)
        identity = server_options.identity
        return None if identity is None else server_options.digest({"identity": identity})

    def spec(options: Mapping[str, Any]) -> PolicySpec:
        with closing(load(options)) as policy:
            return policy.spec

    def contact(options: Mapping[str, Any]) -> Contact:
        with closing(load(options)) as policy:
            return policy.contact(options)

    def wishes(options: Mapping[str, Any]) -> Wishes:
        return read_options(options, kind).wishes

    return PolicyKind(
        name=name,
        summary=summary,
        load=load,
        digest=digest,
        digest_without_start=digest_by_identity,
        spec=spec,
        wishes=wishes,
        contact=contact,
        options=options_of(kind),
    )


KIND = _kind(ServerOptions, "a policy behind a websocket, in openpi's protocol", _openpi)
VLA_EVAL = _kind(VlaEvalOptions, "a policy behind a model server of vla-evaluation-harness", _vla_eval)

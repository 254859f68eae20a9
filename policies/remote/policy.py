"""The policy kinds behind a server, a line for each protocol. Their files are light: a transport is imported on use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Any, Protocol

from robogauntlet.policies.contract import Contact, Policy, PolicyKind, PolicyNotInstalled, PolicySpec, Wishes
from robogauntlet.policies.remote.gr00t import Gr00tOptions, Gr00tPolicy
from robogauntlet.policies.remote.openpi import OpenpiPolicy
from robogauntlet.policies.remote.openvla import OpenVlaOptions, OpenVlaPolicy
from robogauntlet.policies.remote.server_options import ServerOptions, options_of, read_options
from robogauntlet.policies.remote.vla_eval import VlaEvalOptions, VlaEvalPolicy
from robogauntlet.policies.remote.xpolicylab import XPolicyLabOptions, XPolicyLabPolicy


class ServerPolicy(Policy, Protocol):
    """A policy behind a server, see `RemotePolicy`."""

    def digest(self) -> str:
        """Return the hash of the policy's content."""

    def contact(self, options: Mapping[str, Any]) -> Contact:
        """Connect, and return what the server says of itself."""

    def close(self) -> None:
        """Close the connection."""


def _kind(kind: type[ServerOptions], connect: Callable[[Any], ServerPolicy], summary: str) -> PolicyKind:
    name = kind.PROTOCOL
    install = f"pip install 'robogauntlet[{kind.EXTRA}]'" if kind.EXTRA else "pip install websockets msgpack"

    def load(options: Mapping[str, Any]) -> ServerPolicy:
        server_options = read_options(options, kind)
        try:
            return connect(server_options)
        except ModuleNotFoundError as error:
            raise PolicyNotInstalled(
                f"policy '{name}': not installed (no module {error.name}); install it: {install}"
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
        address=kind.FORM,
        needs=", ".join([install] * bool(kind.EXTRA) + ["option convention, or one for each unit"] * kind.ASKS_UNITS),
        options=options_of(kind),
    )


KIND = _kind(ServerOptions, OpenpiPolicy, "a policy behind a websocket, in openpi's protocol")
VLA_EVAL = _kind(VlaEvalOptions, VlaEvalPolicy, "a policy behind a model server of vla-evaluation-harness")
GR00T = _kind(Gr00tOptions, Gr00tPolicy, "a policy behind a policy server of Isaac GR00T, N1.6 or newer")
OPENVLA = _kind(OpenVlaOptions, OpenVlaPolicy, "a policy behind the HTTP server of OpenVLA or OpenVLA-OFT")
XPOLICYLAB = _kind(XPolicyLabOptions, XPolicyLabPolicy, "a policy behind a policy server of XPolicyLab")

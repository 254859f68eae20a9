"""Policies behind a policy server, queried over a websocket: one file a protocol, the rest common."""

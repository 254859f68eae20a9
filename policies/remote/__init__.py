"""Policies behind a policy server, queried over a websocket in openpi's protocol."""

"""Policies behind a policy server, asked over a websocket in openpi's protocol."""

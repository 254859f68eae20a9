"""Policies of other people, asked over a websocket in the protocol of openpi."""

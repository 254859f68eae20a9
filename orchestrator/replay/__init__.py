"""Replay of stored episodes: videos, verification, datasets."""

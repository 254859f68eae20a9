"""Experts of several arms of robosuite, and merges of them."""

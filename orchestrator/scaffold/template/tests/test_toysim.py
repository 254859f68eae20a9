"""Holds the adapter to everything that RoboGauntlet relies on: one test per task and check."""

from orchestrator.conformance import gauntlet_conformance

test_toysim_keeps_the_contract = gauntlet_conformance("toysim")

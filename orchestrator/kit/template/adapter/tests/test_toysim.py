"""Tests the adapter against RoboGauntlet's contract: one test per task and check."""

from robogauntlet.orchestrator.kit import conformance_tests

test_toysim_keeps_the_contract = conformance_tests("toysim")

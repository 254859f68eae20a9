"""Checks that hold an adapter to what policies, perturbations and reports rely on.

`gauntlet adapters check NAME` plays them from the command line, `gauntlet_conformance(NAME)` as tests of pytest. A
family of checks is a module; a check is a function that yields what is wrong.
"""

from orchestrator.conformance.testing import gauntlet_conformance

__all__ = ["gauntlet_conformance"]

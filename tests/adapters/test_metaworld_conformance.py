"""Meta-World's adapter keeps the contract, in three of its tasks."""

import pytest

from adapters import catalog
from orchestrator.conformance import gauntlet_conformance

missing = catalog.missing_reason(catalog.find("metaworld"))
pytestmark = [pytest.mark.simulator, pytest.mark.skipif(missing is not None, reason=str(missing))]

test_metaworld_keeps_the_contract = gauntlet_conformance("metaworld")

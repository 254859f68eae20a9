"""The SO-101's adapter keeps the contract, in two tasks, which have all that PickPlace has."""

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.kit import conformance_tests

missing = catalog.missing_reason(catalog.find("so101"))
pytestmark = [pytest.mark.simulator, pytest.mark.skipif(missing is not None, reason=str(missing))]

test_so101_keeps_the_contract = conformance_tests("so101", tasks=["Stack"])
test_so101_keeps_the_contract_in_others = pytest.mark.nightly(conformance_tests("so101", tasks=["Push"]))

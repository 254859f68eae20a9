"""gymnasium's adapter keeps the contract, in its tasks; `make test` plays one."""

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.kit import conformance_tests

missing = catalog.missing_reason(catalog.find("gymnasium"))
pytestmark = [pytest.mark.simulator, pytest.mark.skipif(missing is not None, reason=str(missing))]

test_gymnasium_keeps_the_contract = conformance_tests("gymnasium", tasks=["FetchPickAndPlace-v4"])
test_gymnasium_keeps_the_contract_in_others = pytest.mark.nightly(
    conformance_tests(
        "gymnasium", tasks=["FetchReach-v4", "PandaReach-v3", "PushT-v0", "AlohaTransferCube-v0", "AlohaInsertion-v0"]
    )
)

"""Meta-World's adapter keeps the contract, in three of its tasks; `make test` plays one."""

import pytest

from robogauntlet.adapters import catalog
from robogauntlet.orchestrator.kit import conformance_tests

missing = catalog.missing_reason(catalog.find("metaworld"))
pytestmark = [pytest.mark.simulator, pytest.mark.skipif(missing is not None, reason=str(missing))]

test_metaworld_keeps_the_contract = conformance_tests("metaworld", tasks=["assembly-v3"])
test_metaworld_keeps_the_contract_in_others = pytest.mark.nightly(
    conformance_tests("metaworld", tasks=["handle-press-v3", "window-open-v3"])
)

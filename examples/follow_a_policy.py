"""Follow a policy from run to run: `python examples/follow_a_policy.py runs/history.sqlite POLICY`.

The cells between `# %%` can be run one by one in an editor or a notebook.
"""

# %%
import sys
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd

from robogauntlet.results.store.database import file_url
from robogauntlet.results.store.run_history import History

file, policy = sys.argv[1:3]
history = History.open(file_url(Path(file)))
results = history.policy_history(policy)

# %% A row per run. Content of another hash is another policy, whatever its name.
table = pd.DataFrame(
    {
        "started": [datetime.fromtimestamp(result.run.started_at, UTC) for result in results],
        "run": [result.run.name for result in results],
        "content": [result.policy_digest[:8] for result in results],
        "rate": [result.counts.rate for result in results],
        "episodes": [result.counts.verdicts for result in results],
        "errors": [result.counts.errors for result in results],
        "verdict": [result.run.verdict or "" for result in results],
    }
)
print(table.to_string(index=False))

# %% Runs that regressed against their baseline, and why.
for result in results:
    if result.run.verdict == "regressed":
        print(result.run.name, *result.run.reasons, sep="\n  ")

history.close()

"""Follow a policy from run to run: `python examples/follow_a_policy.py runs/history.sqlite POLICY [PLOT.svg]`.

The cells between `# %%` can be run one by one in an editor or a notebook.
"""

# %%
import sys
from datetime import UTC, datetime
from pathlib import Path

import pandas as pd

from results.history import History
from results.report.nights import write_plot

file, policy = sys.argv[1:3]
history = History.open_file(Path(file))
nights = history.nights(policy)

# %% A row per run. Another content of the same name is another policy.
table = pd.DataFrame(
    {
        "begun": [datetime.fromtimestamp(night.run.started_at, UTC) for night in nights],
        "run": [night.run.name for night in nights],
        "content": [night.policy_digest[:8] for night in nights],
        "rate": [night.counts.rate for night in nights],
        "episodes": [night.counts.verdicts for night in nights],
        "errors": [night.counts.errors for night in nights],
        "verdict": [night.run.verdict or "" for night in nights],
    }
)
print(table.to_string(index=False))

# %% Which runs were worse than the last good one before them, and why.
for night in nights:
    if night.run.verdict == "regressed":
        print(night.run.name, *night.run.reasons, sep="\n  ")

# %% As a picture.
if len(sys.argv) > 3:
    write_plot(Path(sys.argv[3]), nights, f"{policy}, success from run to run")
history.close()

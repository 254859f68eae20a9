"""Compare two runs: `python examples/compare_two_runs.py runs/TODAY runs/YESTERDAY`.

The cells between `# %%` can be run one by one in an editor or a notebook, where a comparison is displayed as a table.
"""

# %%
import sys

import robogauntlet

comparison = robogauntlet.compare(sys.argv[1], sys.argv[2])
print(comparison)

# %% The same as values: which tasks are worse, by how much, and how certain that is.
for one in comparison.comparisons:
    for contrast in one.contrasts:
        print(
            f"{one.first.policy}, {contrast.task or 'all tasks'}: {contrast.pairs.trials} pairs, "
            f"{100 * contrast.difference.value:+.1f} points, p of worse {contrast.adjusted:.3f}"
        )

# %% Episodes that succeeded before and fail now.
today, before = (robogauntlet.open_run(folder).episodes() for folder in sys.argv[1:3])
both = today.merge(before, on=["policy", "pair_id"], suffixes=("", "_before"))
lost = both[(both["status"] == "failure") & (both["status_before"] == "success")]
print(f"{len(lost)} episodes succeeded before and fail now")
for episode in lost.head(5).itertuples():
    print(f"robogauntlet replay {episode.episode_id[:8]} --run {sys.argv[1]}    # {episode.policy} on {episode.task}")

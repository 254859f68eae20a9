"""Open a run and look at its episodes as a table: `python examples/open_a_run.py runs/NAME`.

The cells between `# %%` can be run one by one in an editor or a notebook.
"""

# %%
import sys

import robogauntlet

run = robogauntlet.open_run(sys.argv[1])
print(run)

# %% A row per episode. What each column means: `robogauntlet.results.record.EpisodeResult`.
episodes = run.episodes()
print(episodes[["task", "policy", "seed", "status", "steps"]].head().to_string(index=False))

# %% Errors are neither successes nor failures: exclude them from rates and count them.
judged = episodes[episodes["status"] != "error"]
success = judged.assign(success=judged["status"] == "success").pivot_table("success", "task", "policy")
print(success.map("{:.0%}".format).to_string())
print(f"{len(episodes) - len(judged)} errors, excluded from the rates")

# %% The same with confidence intervals, as in the report.
for cell in run.tables().cells:
    interval = cell.tally.interval
    if interval is not None:
        print(f"{cell.policy} on {cell.task}: {cell.tally.rate:.2f} [{interval.low:.2f}, {interval.high:.2f}]")

# %% Time by phase (seconds).
print(episodes[["reset_s", "physics_s", "render_s", "inference_s"]].sum().round(2).to_string())

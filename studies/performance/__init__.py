"""What runs cost: frames, steps, answers, the scheduler, the store, the dashboard."""

QUICK = (
    *("rendering", "bound", "frames", "control_step", "bare_loop", "throughput", "answers", "inference", "overhead"),
    *("environments", "behaviour_cost", "vector_env", "remote", "workers"),
)
"""What `make bench` measures: the others take long, or need an installation, demonstrations or a GPU."""
APART = dict.fromkeys(("libero_cost", "libero_frames"), "libero")
"""Tables that are measured in the environment of a simulator."""

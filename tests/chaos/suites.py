"""Suites that are run under faults."""

NULL = """
name: chaos
policies: [oracle, random]
tasks: [null/Slow, null/Reach]
seeds: {count: 120}
workers: 2
episode_time_limit_s: 4
"""
"""480 episodes, half of which take a tenth of a second."""
LONG = NULL.replace("count: 120", "count: 400").replace("workers: 2", "workers: auto")
"""1600 episodes."""
REAL = """
name: chaos-real
policies: [oracle, untrained]
tasks: [maniskill/PushCube-v1, pybullet/PandaPickAndPlace-v3, robosuite/Lift]
seeds: {count: 4}
image_size: 64
render_profile: fast-2
horizon: 48
workers: auto
"""
"""Four seeds of two policies in each of the three simulators."""

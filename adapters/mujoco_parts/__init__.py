"""What the robosuite and LIBERO adapters share: observing, and adjusting cameras, lights, arm, dynamics and table.

Nothing here imports MuJoCo: its module, model and data are handed in by the adapter that opened them.
"""

"""What the adapters of MuJoCo's simulators share: looking, and adjusting cameras, lights, arm, dynamics and table.

Nothing here imports MuJoCo: its module, model and data are handed in by the adapter that opened them.
"""

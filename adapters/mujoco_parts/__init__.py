"""What the adapters of robosuite, LIBERO and the SO-101 share: observing, and adjusting what is in the scene.

Nothing here imports MuJoCo: its module, model and data are handed in by the adapter that opened them.
"""

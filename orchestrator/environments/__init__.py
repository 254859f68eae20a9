"""Python environments beside the running one, for simulators that do not fit into it."""

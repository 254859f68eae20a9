"""Nine experts in three simulators: merged, routed, or kept apart in few bits."""

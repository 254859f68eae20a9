"""What the scripted oracles solve, and which failures are recognised."""

"""Other processes and devices: executors, and what a machine has."""

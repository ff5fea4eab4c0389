"""Other processes and devices: executors, torchrun, and what a machine has."""

"""What is not measured: the delay and the state."""

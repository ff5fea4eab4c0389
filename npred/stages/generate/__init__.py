"""The stage generate: rollouts, and the samples taken from them."""

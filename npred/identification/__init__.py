"""From a recording to the delay and the parameters of a plant, and its limits."""

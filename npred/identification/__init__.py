"""From a recording to the delay and the parameters of a plant, with what the recording cannot tell."""

"""One file per published experiment; npred.registry.EXPERIMENTS has a line for each."""

"""The stage refine: further training on the inputs at which a network failed."""

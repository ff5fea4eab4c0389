"""Training: the loop over epochs, streaming, losses, the optimiser SOAP, and checkpoints."""

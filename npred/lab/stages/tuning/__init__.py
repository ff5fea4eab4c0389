"""Better numbers for the laws of a pipeline's loops: what they cost, and the search for those that cost least."""

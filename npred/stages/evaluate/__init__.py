"""The stage evaluate: errors on held-out samples, closed loops, and maps of convergence."""

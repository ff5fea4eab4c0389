"""The prediction problem for each kind of delay, and the methods that solve it."""

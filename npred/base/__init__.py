"""Errors, checks of arrays, nodes, seeds, named parts, progress: the ground of all other rooms."""

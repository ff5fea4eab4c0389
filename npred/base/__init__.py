"""Errors, checks of arrays, nodes, seeds, named parts, progress: what everything else stands on."""

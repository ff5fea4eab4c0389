"""Samples on the disk: data sets, shards, HDF5."""

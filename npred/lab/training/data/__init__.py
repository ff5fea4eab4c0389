"""Samples on the disk: data sets, shards, HDF5, and files of other programs."""

"""The scheduler: key, hit or run, store; and the reason of every run. One graph, on this machine or on Dask's."""

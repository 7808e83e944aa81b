"""A sweep's tasks on several processes or machines, by Dask. Imports `sweeps.crew` and below."""

"""Studies the paper speaks of: each a call, a command, a figure and a table.

>>> from gpuspec.studies import coverage
>>> outcome = coverage.study(gpuspec.Station.read("trim.toml"))
>>> outcome.figure()
"""

"""Studies the paper speaks of: each a call, a command, a figure and a table.

>>> outcome = gpuspec.study("coverage", gpuspec.Station.read("trim.toml"))
>>> outcome.figure()

The study of each name is the function `study` of the file of that name, which tells its parameters:
`gpuspec.studies.coverage.study`.

A file a study: its law, what it finds, table and picture. Imports `simulation` and what stands
below it.
"""

"""Studies the paper speaks of: each a call, a command, a figure and a table.

>>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
>>> outcome = gpuspec.study("coverage", station)
>>> outcome.numbers()["images_needed_per_period"]
4
>>> outcome.figure()
<Figure size ...>

The study of each name is the function `study` of the file of that name, which tells its parameters:
`gpuspec.studies.coverage.study`.

A file a study: its law, what it finds, table and picture. Imports `simulation` and what stands
below it.
"""

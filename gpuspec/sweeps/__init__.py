"""Sweeps: many stations at once, scored at every threshold, stored, compared and chosen from.

The way through, a file for each step:

- what to try: `axes` (a key and its values), `plan` (every design by number);
- trying it: `parts` (light maps on the device), `sampling` (which pixels stand for all),
  `curves` (P1, P2 and hits at all thresholds), `bench` (from designs to rows), `table`;
- keeping it: `store` (the folder), `run` (what is missing is done, what was screened made exact),
  `estimate`; `cluster`, `workers` and `remote` (the same on several processes or machines);
- choosing: `choice` (the rule), `front` (what nothing beats), `chosen`, `scores`, `sensitivity`,
  `maps`; their pictures in `front_picture` and `diagrams`;
- searching without a grid: `optimise`.

`commands`, `front_command` and `optimise_command` are the command line.
"""

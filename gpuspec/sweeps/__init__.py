"""Sweeps: many stations at once, scored at every threshold, stored, compared and chosen from.

The way through:

- what to try: `axes` (a key and its values), `plan` (every design by number), `rule` (the best);
- `trying` it: light maps of the parts, levels counted, P1, P2 and hits at all thresholds;
- `keeping` it: the folder and its rows;
- `choosing`: the front, the choice, and their pictures;
- `searching` between bounds, without a grid;
- `sweep` is all of it, by a `crew`: this process alone, or a `cluster`; `estimate` and `notes` tell
  beforehand what it takes and what to know.

Imports `simulation` and what stands below it.
"""

"""What the station file says, validated: sections, keys, paths and mistakes. No array, no device.

`station` is the whole file, `sections` and `defects` what is in it, `toml` its text, `examples`
those that are shipped; `mistakes` turns what is wrong into sentences, `keys` lists what may be
written, `numeric` which of it are numbers, `corners` what of it may be off. Imports `topographies`
(the size of a measured part) and what stands below it.
"""

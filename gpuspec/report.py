"""What a run leaves behind in a folder; it takes what it writes, not a result.

Imports `pictures` and what stands below it.
"""

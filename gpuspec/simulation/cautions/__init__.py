"""What a user should know before trusting a score, a file for each thing it is known of.

`station` tells it without an image, `light`, `defects` and `detection` from images; `all` puts it
together. A wrong diagnosis is worse than none: each is said only where it is true.
"""

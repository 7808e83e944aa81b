"""The way through for a real camera's frames: frames → aspect image → blobs → decision.

`inspect` takes files or arrays, `captured` is what it gives, `line` takes frames one at a time,
`cameras` gives them as cameras do.
Stands beside `simulation`, which does the same for a station that is simulated.
"""

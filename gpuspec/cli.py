"""The command line, a file for each command; nothing imports it.

`main` puts the commands together; `options`, `terminal` and `tables` are what they share.
"""

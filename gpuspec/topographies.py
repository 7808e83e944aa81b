"""Measured heights as files hold them: units, gaps, form; and surfaces that are made to try.

Knows no station. Imports `errors` and `units` alone.
"""

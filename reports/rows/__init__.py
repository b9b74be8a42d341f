"""Rows of a run: the jobs that a study needs, what is measured of what they made, and what is decided."""

"""Speed beside Mitsuba's, both sides in one run: rays a second, seconds to equal error, and how ours scales.

`rays`, `terms` and `scaling` each give one JSON value; `reports.pages.bench` makes a page of whichever exist.
"""

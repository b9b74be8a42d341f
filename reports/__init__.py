"""Measurements, verdicts and their presentation."""

"""Intervals of a repeat, scored on groups of repeats: measured ones and simulated ones."""

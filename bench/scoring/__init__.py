"""Scores of estimates against true values, summaries over replicates, and calibration tests."""

VERSION = 1
"""Version of the scoring. Raise it when a change of data, scores, summaries or bounds alters results."""

"""From an estimate and the truth to scores, from scores to summaries and tests of calibration."""

VERSION = 1
"""Raised where a change of the data, the scores, their summaries or the bounds alters results."""

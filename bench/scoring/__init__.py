"""From an estimate and the truth to scores, from scores to summaries, comparisons and tests of calibration."""

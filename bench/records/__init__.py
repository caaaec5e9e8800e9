"""Measured records, whose true parameters are unknown: reading, identification, intervals, diagnostics, certificate."""

"""Measured records: read, fitted, reported; there is no truth to score against."""

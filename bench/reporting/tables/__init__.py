"""The tables of results, from stored cells alone."""

"""Tables of results, from stored cells alone."""

"""Stored cells: their identity, version, files, provenance, and the claims of runs that compute them."""

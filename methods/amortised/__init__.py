"""Amortised inference: a density trained once on simulations, then read for every record of the same layout."""

"""Samplers of the posterior: an ensemble sampler and the No-U-Turn sampler."""

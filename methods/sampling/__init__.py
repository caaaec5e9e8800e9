"""Samplers of the posterior: emcee and the No-U-Turn sampler."""

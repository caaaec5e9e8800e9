"""Difference equations of sampled motion: autoregression, recursive autoregression, iterated quadratic maximum likelihood."""

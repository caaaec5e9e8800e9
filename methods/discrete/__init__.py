"""Difference equations of sampled motion: autoregression, batch or recursive, and its maximum likelihood."""

"""Difference equations of sampled motion: autoregression, at once or recursive, and its maximum likelihood."""

"""Rounds: problems with true values drawn by a secret seed, solved through files alone."""

"""Rounds: problems whose truth is drawn by a secret seed, solved and answered through files alone."""

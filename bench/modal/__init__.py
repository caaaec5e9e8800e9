"""Modes of free decays, blows and frequency responses: their likelihood, their bound, and the track of the methods."""

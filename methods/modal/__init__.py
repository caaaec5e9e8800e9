"""Identification from free decays: logarithmic decrement, matrix pencil, eigensystem realisation."""

"""Tables, figures, pages and texts for the terminal, from stored cells; this package computes none."""

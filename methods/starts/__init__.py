"""Initial guesses for iterative fits, and the ambiguity of their estimates (aliases and other local maxima)."""

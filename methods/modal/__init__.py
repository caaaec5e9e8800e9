"""Free decays read as modes: logarithmic decrement, matrix pencil, eigensystem realisation."""

"""What follows from a system's one residual: acceleration, matrices, responses in time, modes."""

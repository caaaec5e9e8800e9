"""Ways to the minimum of one loss: each takes it and a vector to start from, and returns the vector it reached."""

"""Planning a test: what a free decay would tell before it is taken, and the cheapest that tells enough."""

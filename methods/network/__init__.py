"""The tanh network and its derivatives, and the data-driven neural network on it."""

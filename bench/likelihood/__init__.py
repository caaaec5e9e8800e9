"""The likelihood of output error: what a response leaves of the data, its derivatives, and its maximum."""

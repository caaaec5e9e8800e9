"""The atlas: what a free-decay test can tell, and what methods make of it, over all that such a test can be."""

"""What sweeps survive, and what they cost: one script a claim, each run by ``python -m benchmarks.sweeps.<name>``."""

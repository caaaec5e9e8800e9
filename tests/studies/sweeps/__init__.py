"""What sweeps survive, and what they cost: one script a claim, run by ``python -m tests.studies.sweeps.<name>``."""

"""The Silverbox, a measured electronic Duffing oscillator: ``python -m tests.studies.silverbox``."""

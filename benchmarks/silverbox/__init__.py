"""The Silverbox, a measured electronic Duffing oscillator: ``python -m benchmarks.silverbox``."""

"""The launcher of this benchmark for Hydra."""

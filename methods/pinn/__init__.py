"""The physics-informed neural network (:mod:`methods.pinn.method`); importing this package does not import torch."""

from methods.pinn.method import PINN

__all__ = ["PINN"]

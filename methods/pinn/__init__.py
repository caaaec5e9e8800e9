"""The physics-informed neural network: see :mod:`methods.pinn.method`, its card. Loads no torch by itself."""

from methods.pinn.method import PINN

__all__ = ["PINN"]

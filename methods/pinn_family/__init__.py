"""The PINN family: one loss, many ways to train; see :mod:`methods.pinn_family.method`. Loads no torch by itself."""

from methods.pinn_family.method import PINNFamily

__all__ = ["PINNFamily"]

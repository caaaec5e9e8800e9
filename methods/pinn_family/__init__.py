"""The PINN family: one loss with many training methods (:mod:`methods.pinn_family.method`).

:class:`Optimizer`, :class:`Weighting` and :class:`Features` are base classes for components of other packages.
Importing this package does not import torch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from methods.pinn_family.method import PINNFamily

if TYPE_CHECKING:
    from methods.pinn_family.architectures import Features
    from methods.pinn_family.loss import Optimizer
    from methods.pinn_family.weighting import Weighting

__all__ = ["Features", "Optimizer", "PINNFamily", "Weighting"]


def __getattr__(name: str) -> Any:
    """Return a base class, whose module imports torch."""
    modules = {"Features": "architectures", "Optimizer": "loss", "Weighting": "weighting"}
    if name not in modules:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    return getattr(import_module(f"{__name__}.{modules[name]}"), name)

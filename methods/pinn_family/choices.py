"""The values of the family's settings, with their titles in tables, sources and packages.

Other packages can add optimisers, weightings and architectures by entry points of the groups
``pinn_family.optimizers``, ``pinn_family.weightings`` and ``pinn_family.architectures``. Importing this module does not
import torch.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any, ClassVar

from bench import Choice, InputError, check_name, entry_points_of, load_entry_point


class TrainingComponent:
    """Base class of optimisers, weightings and architectures; a component of another package defines these attributes.

    ``title``: name in tables; ``source``: publication; ``package``: package used for its computation; ``version``:
    increased when a change of the class alters results, so that stored results become stale.
    """

    title: ClassVar[str] = ""
    source: ClassVar[str] = ""
    package: ClassVar[str] = ""
    version: ClassVar[int] = 1


class OpenChoices(Mapping[str, Choice]):
    """The values of a setting: built-in ones, and those registered by installed packages, loaded on access.

    ``base``: module and base class of the components; ``COMPONENTS`` of the module has the built-in ones.
    """

    def __init__(self, setting: str, base: str, builtin: Mapping[str, Choice]) -> None:
        self.setting, self.builtin, self.group = setting, builtin, f"pinn_family.{setting}s"
        self.module, _, self.base = base.partition(":")

    def __iter__(self) -> Iterator[str]:
        return iter({**self.builtin, **entry_points_of(self.group)})

    def __len__(self) -> int:
        return len({**self.builtin, **entry_points_of(self.group)})

    def __contains__(self, name: object) -> bool:
        return name in self.builtin or name in entry_points_of(self.group)

    def __getitem__(self, name: str) -> Choice:
        if name in self.builtin or name not in self:
            return self.builtin[name]
        component, point = self.load(name), entry_points_of(self.group)[name]
        package = component.package or (point.dist.name if point.dist else "")
        return Choice(component.title, component.source, package, point.value, component.version)

    def load(self, name: str) -> Any:
        """Return the class of a value; built-in names take precedence.

        Raises InputError for an entry point that cannot be loaded or lacks a required attribute.
        """
        module = import_module(f"methods.pinn_family.{self.module}")
        if name in module.COMPONENTS:
            return module.COMPONENTS[name]
        field, points, base = f"method.{self.setting}", entry_points_of(self.group), getattr(module, self.base)
        component = load_entry_point(field, name, points, base, needs=("title", "source", "version"))
        if type(component.version) is not int or component.version < 1:
            stated = f"the version of its entry point ({points[name].value}) is {component.version!r}"
            raise InputError(field, name, f"{stated}; a whole number from 1")
        return component

    def check(self, value: str) -> None:
        """Raise InputError for a value that is neither built in nor registered, or whose entry point is broken."""
        check_name(f"method.{self.setting}", value, list(self))
        if value not in self.builtin:
            self.load(value)


OPTIMIZERS = OpenChoices(
    "optimizer",
    "optimizers:Optimizer",
    {
        "adam": Choice("Adam", "D. P. Kingma and J. Ba, ICLR 2015", "torch"),
        "adam_lbfgs": Choice(
            "Adam, then L-BFGS", "the paper's; D. C. Liu and J. Nocedal, Math. Program. 45:503, 1989", "scipy"
        ),
        "lbfgs": Choice("L-BFGS", "D. C. Liu and J. Nocedal, Math. Program. 45:503, 1989", "scipy"),
        "soap": Choice("SOAP", "N. Vyas et al., ICLR 2025", "pytorch_optimizer"),
        "muon": Choice("Muon", "K. Jordan et al., 2024", "torch"),
        "self_scaled_bfgs": Choice("self-scaled BFGS", "J. F. Urbán et al., J. Comput. Phys. 523:113656, 2025"),
        "self_scaled_broyden": Choice("self-scaled Broyden", "J. F. Urbán et al., J. Comput. Phys. 523:113656, 2025"),
        "nystrom_newton_cg": Choice("Adam, then Nyström-Newton-CG", "P. Rathore et al., ICML 2024"),
        "natural_gradient": Choice(
            "energy natural gradient", "J. Müller and M. Zeinhofer, ICML 2023; a Gauss-Newton step with a line search"
        ),
        "variable_projection": Choice(
            "random features, variable projection", "V. Dwivedi and B. Srinivasan, Neurocomputing 391:96, 2020", "scipy"
        ),
        "lm": Choice("Levenberg-Marquardt", "H. B. Nielsen, IMM-REP-1999-05; in residual space as the PINN here"),
    },
)
WEIGHTINGS = OpenChoices(
    "weighting",
    "weighting:Weighting",
    {
        "noise": Choice("by the estimated noise", "minus the log posterior, as the PINN here"),
        "paper": Choice("fixed, all one", "the paper's: selected empirically"),
        "relobralo": Choice("ReLoBRaLo", "R. Bischof and M. Kraus, arXiv:2110.09813, 2021"),
        "tangent_kernel": Choice("neural tangent kernel", "S. Wang et al., J. Comput. Phys. 449:110768, 2022"),
        "gradient_norms": Choice(
            "gradient norms", "S. Wang et al., SIAM J. Sci. Comput. 43:A3055, 2021; arXiv:2308.08468"
        ),
        "self_adaptive": Choice(
            "self-adaptive", "L. McClenny and U. Braga-Neto, J. Comput. Phys. 474:111722, 2023", "torch"
        ),
        "attention": Choice("residual-based attention", "S. Anagnostopoulos et al., CMAME 421:116805, 2024"),
        "augmented_lagrangian": Choice(
            "augmented Lagrangian", "D. P. Bertsekas, 1982; PINNverse, arXiv:2504.05248, 2025"
        ),
        "causal": Choice("causal", "S. Wang et al., CMAME 421:116813, 2024"),
    },
)
ARCHITECTURES = OpenChoices(
    "architecture",
    "architectures:Features",
    {
        "tanh": Choice("tanh network", "the paper's: two hidden layers of 64", "torch"),
        "sine": Choice("sine activations", "V. Sitzmann et al., NeurIPS 2020", "torch"),
        "fourier": Choice("Fourier features", "S. Wang, H. Wang and P. Perdikaris, CMAME 384:113938, 2021", "torch"),
        "kolmogorov_arnold": Choice(
            "Kolmogorov-Arnold", "Z. Liu et al., ICLR 2025; bumps of arXiv:2405.06721", "torch"
        ),
        "pirate": Choice("PirateNet", "S. Wang et al., J. Mach. Learn. Res. 25:402, 2024", "torch"),
        "spline": Choice("B-spline", "J. M. Varah, SIAM J. Sci. Stat. Comput. 3:28, 1982", "scipy"),
    },
)
SAMPLINGS: Mapping[str, Choice] = {
    "uniform": Choice("evenly spaced", "the paper's: 200 points"),
    "random": Choice("drawn anew each step", "M. Raissi et al., J. Comput. Phys. 378:686, 2019, as commonly trained"),
    "adaptive": Choice("where the residual is large", "C. Wu et al., CMAME 403:115671, 2023"),
}
UNCERTAINTIES: Mapping[str, Choice] = {
    "laplace": Choice("Laplace, all weights", "D. MacKay, Neural Comput. 4:448, 1992; weights profiled out"),
    "last_layer": Choice("Laplace, output layer", "E. Daxberger et al., NeurIPS 2021"),
    "ensemble": Choice("deep ensemble", "the paper's; B. Lakshminarayanan et al., NeurIPS 2017"),
    "bootstrap": Choice("parametric bootstrap", "B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993"),
    "nuts": Choice("Bayesian PINN, NUTS", "L. Yang et al., J. Comput. Phys. 425:109913, 2021", "blackjax"),
    "variational": Choice("variational, mean field", "C. Blundell et al., ICML 2015", "torch"),
    "dropout": Choice("Monte-Carlo dropout", "Y. Gal and Z. Ghahramani, ICML 2016", "torch"),
}

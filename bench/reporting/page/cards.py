"""The cards of the registered methods: what each does, is told, and was tuned on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

from bench.config.choices import choices
from bench.contract.method import Card, Serves
from bench.entrants.registry import default_settings, load_method, missing_package, registered
from bench.errors import InputError
from bench.reporting.labels import title
from bench.reporting.page.words import joined


@dataclass(frozen=True)
class Description:
    """A card ready for the page; ``broken`` says why a registered method has none.

    ``variants``: of each its name in ``conf``, its title, and what it sets.
    """

    name: str
    title: str
    card: Card | None
    serves: str
    settings: tuple[tuple[str, str], ...]
    variants: tuple[tuple[str, str, str], ...]
    missing: str
    broken: str


def cards() -> list[Description]:
    """All registered methods, by name."""
    return [_shown(name) for name in registered()]


def about(shown: Sequence[Description]) -> dict[str, str]:
    """By title, what a method or variant is, in a line."""
    found = {}
    for one in shown:
        if one.card:
            found[one.title] = one.card.summary
            found |= {name: f"{one.card.summary}; with {text}" for _, name, text in one.variants}
    return found


def _shown(name: str) -> Description:
    try:
        method = load_method(name)
        settings = {key: "–" if value is None else str(value) for key, value in default_settings(name).items()}
    except InputError as error:
        return Description(name, title(name), None, "", (), (), "", str(error))
    serves = _serves(method.serves)
    missing = missing_package(name) or ""
    return Description(name, title(name), method.card, serves, tuple(settings.items()), _variants(name), missing, "")


def _variants(name: str) -> tuple[tuple[str, str, str], ...]:
    """The files of ``conf/method`` that start from a method: name, title, and what they set."""
    from omegaconf import OmegaConf

    found = []
    for choice in choices("method"):
        path = files("conf").joinpath("method", f"{choice}.yaml")
        if not path.is_file():
            continue
        content = dict(OmegaConf.to_container(OmegaConf.create(path.read_text(encoding="utf-8"))))  # type: ignore[arg-type]
        if content.pop("defaults", None) == [name]:
            found.append((choice, title(choice), ", ".join(f"{key}={value}" for key, value in content.items())))
    return tuple(found)


def _serves(serves: Serves) -> str:
    """What a method can take, in a sentence."""
    masses = (
        "any number of masses"
        if serves.max_dof is None
        else f"up to {serves.max_dof} mass{'es' if serves.max_dof > 1 else ''}"
    )
    can = {
        "a known force": serves.forced, "nonlinear systems": serves.nonlinear, "hidden states": serves.hidden_states,
        "several records": serves.several_records, "several sensors": serves.several_channels,
        "a sensor's offset": serves.offsets, "a known added mass": serves.added_mass,
        "free vibration without a prior": serves.free_without_prior,
    }  # fmt: skip
    yes, no = [k for k, v in can.items() if v], [k for k, v in can.items() if not v]
    text = f"{joined([m.replace('_', ' ') for m in serves.measures])} of {masses}"
    text += f"; takes {joined(yes)}" if yes else ""
    return text + (f"; not {joined(no, 'nor')}" if no else "")

"""From command-line overrides to validated cells: Hydra composes, pydantic validates, before anything runs."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from bench.cell import Cell
from bench.disturbance import Disturbance, make_disturbance
from bench.errors import InputError
from bench.excitation import Shape
from bench.failure import one_line
from bench.problem import Hold
from bench.reference import REFERENCES
from bench.registry import default_settings, load_method, make_method, method_names, registered
from bench.scenario import ForceSpec, PriorSpec, Scenario
from bench.suggest import did_you_mean

GROUPS = ("method", "system", "prior", "disturbance", "experiment")
COMPOSED = ("method", "system", "prior", "disturbance")
"""Groups whose files Hydra composes."""
OF_EXPERIMENTS = ("sweep", "also", "replicates_by_method", "table")
"""Fields that an experiment alone sets."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(allow_inf_nan=False, gt=0)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class InitialConfig(_Strict):
    """The true state at time 0: metres and metres a second, one number a DOF."""

    displacement: list[Finite]
    velocity: list[Finite]


class ForceConfig(_Strict):
    """A known force; see :class:`bench.excitation.ForceSpec`."""

    kind: Shape = "multisine"
    amplitude: Positive
    low_hz: Positive | None = None
    high_hz: Positive | None = None
    tones: Annotated[int, Field(ge=1)] = 10
    samples: Annotated[int, Field(ge=2)] = 201
    hold: Hold = "linear"
    dof: Annotated[int, Field(ge=0)] = 0
    start_s: Annotated[float, Field(allow_inf_nan=False, ge=0)] = 0.0
    length_s: Positive | None = None
    file: str | None = None
    noise_db: Finite | None = None


class SystemConfig(_Strict):
    """A file of ``conf/system``: true parameters (SI units) and how the record is sampled."""

    label: str
    kind: str
    options: dict[str, Any]
    parameters: dict[str, Positive]
    initial: InitialConfig
    duration: Positive
    samples: Annotated[int, Field(ge=3, le=100_000)]
    force: ForceConfig | None
    measured: list[Annotated[int, Field(ge=0)]] | None = None
    """The DOFs (from 0) that have a sensor; null: all."""
    added_mass: list[Finite] | None = None
    """Known masses (kg, one a DOF) that a second record of the same rig carries; null: there is one record."""
    default_prior: Literal["nominal", "none"] = "nominal"
    """The prior of this scenario unless one is chosen: none where a force makes every parameter identifiable."""


class PriorConfig(_Strict):
    """A file of ``conf/prior``: standard deviations of the logarithm by kind of parameter, or none."""

    name: str
    sd_by_kind: dict[Literal["mass", "damping", "stiffness", "other"], Positive] | None
    wrong: bool
    draws: Literal["nominal", "truth"] = "nominal"


class DisturbanceConfig(_Strict):
    """A file of ``conf/disturbance``: a kind of :mod:`bench.disturbance` and its settings."""

    kind: str
    size: Finite | None = None
    share: Finite | None = None


class Config(_Strict):
    """One cell's configuration, and the fields that an experiment adds. Unknown fields are refused."""

    method: dict[str, Any]
    system: SystemConfig
    prior: PriorConfig
    disturbance: DisturbanceConfig
    snr: Annotated[float, Field(allow_inf_nan=False, ge=-40, le=300)]
    replicates: Annotated[int, Field(ge=1, le=1_000_000)]
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    initial_state: Literal["known", "unknown"]
    store: Path
    archive: str | None
    format: Literal["table", "json"]
    workers: Annotated[int, Field(ge=1, le=1024)] | None
    timeout_s: Positive
    memory_mb: Annotated[float, Field(allow_inf_nan=False, ge=100)]
    retry: str
    dry_run: bool
    cells_per_job: Annotated[int, Field(ge=1)]
    data: Path | None
    nominal: dict[str, Positive]
    start: list[Finite] | None
    sweep: dict[str, list[Any]]
    also: list[dict[str, list[Any]]]
    replicates_by_method: dict[str, Annotated[int, Field(ge=1)]]
    table: dict[str, Any] | None


FIELDS = (
    *(name for name in Config.model_fields if name not in OF_EXPERIMENTS),
    "experiment",
)
"""What a command line can set; the rest is for experiments."""


@dataclass(frozen=True)
class Job:
    """A validated configuration, with the variant of the method as the command line named it."""

    config: Config
    label: str
    explicit: frozenset[str]
    """Fields that the user set, as opposed to defaults."""

    def prior_spec(self) -> PriorSpec | None:
        prior = self.config.prior
        if prior.sd_by_kind is None:
            return None
        return PriorSpec(prior.name, {str(kind): sd for kind, sd in prior.sd_by_kind.items()}, prior.wrong, prior.draws)

    def disturbance(self) -> Disturbance | None:
        """The disturbance; raises InputError where its settings do not make sense."""
        settings = self.config.disturbance.model_dump(exclude_none=True)
        return make_disturbance(settings.pop("kind"), settings)

    def settings(self) -> dict[str, Any]:
        """All settings of the method, defaults included, as validated plain values."""
        name, given = self.config.method["name"], {k: v for k, v in self.config.method.items() if k != "name"}
        if name in REFERENCES:
            return {}
        method = make_method(name, given)
        return {key: getattr(method, key) for key in default_settings(name)}

    def cell(self) -> Cell:
        """The cell; raises InputError where the scenario does not make sense."""
        config, system = self.config, self.config.system
        scenario = Scenario(
            system=system.kind,
            parameters=dict(system.parameters),
            initial=(tuple(system.initial.displacement), tuple(system.initial.velocity)),
            snr_db=config.snr,
            duration=system.duration,
            samples=system.samples,
            told=config.initial_state,
            prior=self.prior_spec(),
            force=ForceSpec(**system.force.model_dump()) if system.force else None,
            options=dict(system.options),
            label=system.label,
            disturbance=self.disturbance(),
            measured=None if system.measured is None else tuple(system.measured),
            added_mass=None if system.added_mass is None else tuple(system.added_mass),
        )
        settings = {key: list(v) if isinstance(v, tuple) else v for key, v in self.settings().items()}
        return Cell(
            scenario=scenario,
            method=config.method["name"],
            settings=settings,
            replicates=config.replicates,
            seed=config.seed,
            label=self.label,
        )


@cache
def choices(group: str) -> list[str]:
    """What may be chosen for a group: the files of ``conf``, and for methods the registered ones too."""
    folder = files("conf").joinpath(group)
    found = [entry.name[: -len(".yaml")] for entry in folder.iterdir() if entry.name.endswith(".yaml")]
    return sorted({*found, *(method_names() if group == "method" else ())})


def of_launcher(text: str) -> bool:
    """Whether an override is one of Hydra's own: ``hydra/launcher=ray``, ``hydra.launcher.partition=debug``."""
    return text.lstrip("+~").startswith(("hydra/", "hydra."))


def read_overrides(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Overrides by field, each with the values to sweep over (one, unless swept), in Hydra's override grammar."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    parser = OverridesParser.create()
    values: dict[str, list[Any]] = {}
    for text in texts:
        try:
            override = parser.parse_overrides([text])[0]
        except HydraException:
            raise InputError("argument", repr(text), _how_to_write(text)) from None
        key = override.get_key_element()
        if key.split(".")[0] not in FIELDS:
            near = did_you_mean(key, FIELDS)
            raise InputError(key, _after_equals(text), f"not a field; {near}fields: {', '.join(FIELDS)}")
        if key in values:
            raise InputError(key, _after_equals(text), "given twice; give it once")
        values[key] = _swept(override, key, text)
        if key in GROUPS:
            for value in values[key]:
                _known_choice(key, value)
    return values


def _how_to_write(text: str) -> str:
    """What is wrong with an argument that is no ``field=value``."""
    groups = [group for group in GROUPS if text in choices(group)]
    if groups:
        return f"did you mean {groups[0]}={text}? write field=value, see --help"
    return "write field=value, without spaces or dashes, see --help"


def _after_equals(text: str) -> str:
    return text.partition("=")[2]


def _swept(override: Any, key: str, text: str) -> list[Any]:
    from hydra.core.override_parser.types import Glob, QuotedString

    if not override.is_sweep_override():
        value = override.value()
        return [value.text if isinstance(value, QuotedString) else value]
    if isinstance(override.value(), Glob):
        found = override.value().filter(choices(key)) if key in GROUPS else []
        if not found:
            raise InputError(key, _after_equals(text), "matches nothing")
        return list(found)
    found = [v.text if isinstance(v, QuotedString) else v for v in override.sweep_iterator()]
    if not found:
        raise InputError(key, _after_equals(text), "sweeps over nothing")
    return found


def _known_choice(group: str, value: Any) -> None:
    if _own_file(group, value):
        return
    if value not in choices(group) and not (group == "experiment" and value is None):
        raise InputError(group, value, f"{did_you_mean(value, choices(group))}known: {', '.join(choices(group))}")
    if group == "method" and value in registered():
        load_method(value)  # a broken entry point is said here


def _own_file(group: str, value: Any) -> bool:
    """Whether a choice names a file of one's own: ``system=<path>.yaml``; raises InputError if it is not there."""
    named = group == "system" and isinstance(value, str) and value.endswith(".yaml")
    if named and not Path(value).is_file():
        raise InputError(group, value, "there is no such file; give the path of a file like those of conf/system")
    return named


def _register_file(path: str) -> str:
    """Give Hydra a scenario from a file of one's own, which may start from one of ``conf/system``; its name there."""
    from hydra.core.config_store import ConfigStore
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    try:
        text = Path(path).read_text(encoding="utf-8")
        content = OmegaConf.to_container(OmegaConf.create(text))
    except (OSError, UnicodeDecodeError, YAMLError, OmegaConfBaseException) as error:
        raise InputError("system", path, f"it cannot be read: {one_line(error)}") from None
    if not isinstance(content, dict) or not content:
        raise InputError("system", path, "fields like those of the files of conf/system are wanted")
    name = f"file_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    ConfigStore.instance().store(group="system", name=name, node=content)
    return name


def expand(texts: Sequence[str], multirun: bool) -> list[Job]:
    """All jobs of a command line: the product of its sweeps and, with ``multirun``, of its experiment's."""
    overrides = read_overrides(texts)
    experiment = overrides.pop("experiment", [None])
    if len(experiment) > 1:
        others = [text for text in texts if not text.startswith("experiment=")]
        return [job for name in experiment for job in expand([*others, f"experiment={name}"], multirun)]
    set_by_experiment = _experiment(experiment[0])
    jobs = []
    for block in [{}, *set_by_experiment.get("also", [])]:
        # what the command line sets is no longer the part of the experiment that the block describes
        if not set(block) & set(overrides):
            sweep = {**set_by_experiment.get("sweep", {}), **block, **overrides}
            jobs += _expand_sweep(sweep, set_by_experiment, frozenset(overrides), multirun)
    return jobs


def _expand_sweep(
    sweep: Mapping[str, list[Any]], experiment: Mapping[str, Any], explicit: frozenset[str], multirun: bool
) -> list[Job]:
    for group in set(GROUPS) & set(sweep):
        for value in sweep[group]:
            _known_choice(group, value)
    swept = [key for key, values in sweep.items() if len(values) > 1]
    if swept and not multirun:
        remedy = "several values need -m: python -m bench -m ..."
        raise InputError(swept[0], ",".join(map(str, sweep[swept[0]])), remedy)
    if "method" not in sweep:
        raise InputError("method", "", f"choose one: {', '.join(choices('method'))}")
    jobs = []
    for values in itertools.product(*sweep.values()):
        chosen = dict(zip(sweep, values, strict=True))
        jobs.append(_job(chosen, experiment, explicit))
    return jobs


def _job(chosen: Mapping[str, Any], experiment: Mapping[str, Any], explicit: frozenset[str]) -> Job:
    plain = {k: v for k, v in chosen.items() if k not in GROUPS and "." not in k}
    composed_by = {k: v for k, v in chosen.items() if k not in plain}
    content = _compose(composed_by)
    default_prior = content["system"].get("default_prior", "nominal")
    if "prior" not in chosen and default_prior != content["prior"]["name"]:
        content = _compose({**composed_by, "prior": default_prior})
    fields = {k: v for k, v in experiment.items() if k not in OF_EXPERIMENTS}
    by_method = experiment.get("replicates_by_method", {})
    if chosen["method"] in by_method and "replicates" not in explicit:
        fields["replicates"] = by_method[chosen["method"]]
    content |= {**fields, **plain}
    label = str(chosen["method"])
    settings = [f"{k.partition('.')[2]}={v}" for k, v in chosen.items() if k.startswith("method.")]
    try:
        config = Config.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"] if part not in ("constrained-float", "constrained-int"))
        raise InputError(where, first["input"], first["msg"].lower()) from None
    if not str(content["store"] or ""):
        raise InputError("store", "", "name a folder")
    return Job(config, " ".join([label, *settings]), explicit)


def _compose(chosen: Mapping[str, Any]) -> dict[str, Any]:
    """The composed configuration; each group by itself, since none refers to another: a sum of compositions, which take
    a tenth of a second, instead of a product."""
    literals = {key: _literal(value) for key, value in chosen.items()}
    if _own_file("system", chosen.get("system")):
        literals["system"] = _register_file(chosen["system"])
    rest = tuple((key, text) for key, text in literals.items() if key.split(".")[0] not in COMPOSED)
    content: dict[str, Any] = json.loads(_composed(rest))
    for group in COMPOSED:
        own = tuple((key, text) for key, text in literals.items() if key.split(".")[0] == group)
        if own:
            content[group] = json.loads(_composed(own))[group]
    return content


def _literal(value: Any) -> str:
    return json.dumps(value) if isinstance(value, list | dict) or value is None else str(value)


def _experiment(name: str | None) -> dict[str, Any]:
    """The fields that an experiment sets."""
    from omegaconf import OmegaConf

    if name is None:
        return {}
    text = files("conf").joinpath("experiment", f"{name}.yaml").read_text(encoding="utf-8")
    content = OmegaConf.to_container(OmegaConf.create(text))
    assert isinstance(content, dict)
    return {str(key): value for key, value in content.items()}


@cache
def _composed(overrides: tuple[tuple[str, str], ...]) -> str:
    """The composed configuration as JSON; once for each choice of groups and nested fields."""
    from hydra import compose, initialize_config_module
    from hydra.errors import HydraException
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    register_methods()
    # nominal starts out empty: its fields are added, all others must be there
    texts = [f"{'++' if key.startswith('nominal.') else ''}{key}={value}" for key, value in overrides]
    try:
        with initialize_config_module("conf", version_base="1.3"):
            config = OmegaConf.to_container(compose("config", overrides=texts), resolve=True)
    except (HydraException, OmegaConfBaseException) as error:
        match = re.search(r"'([\w.]+)'", str(error))
        key = match.group(1) if match and match.group(1) in dict(overrides) else overrides[-1][0]
        reason = "no such field" if "Could not override" in str(error) else str(error).splitlines()[0]
        raise InputError(key, dict(overrides).get(key, ""), reason) from None
    return json.dumps(config)


@cache
def register_methods() -> None:
    """Give Hydra a configuration for every registered method: its settings with their defaults."""
    from hydra.core.config_store import ConfigStore

    for name in [*registered(), *REFERENCES]:
        try:
            settings = default_settings(name)
        except InputError:
            continue  # said when, and only if, that method is chosen
        ConfigStore.instance().store(group="method", name=name, node={"name": name, **settings})


def jobs_to_cells(jobs: Sequence[Job]) -> list[Cell]:
    """The cells of all jobs; raises InputError for the first that does not make sense, before any runs."""
    return [job.cell() for job in jobs]

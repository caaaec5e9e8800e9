"""Versions: a stored cell is current where the numbers of its method, its system and the scoring are today's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from stored import described, save, scored

from bench import scoring
from bench.commands.status import standings, store_page
from bench.entrants.registry import load_method, method_names
from bench.errors import InputError
from bench.store.bounds import bound_version
from bench.store.store import Store
from bench.store.version import NUMBERS, cell_version, described_version
from bench.systems import load_system, registered_systems


@pytest.fixture(autouse=True)
def _read_anew() -> Iterator[None]:
    cell_version.cache_clear()
    yield
    cell_version.cache_clear()


def test_every_method_and_system_has_a_whole_number() -> None:
    for name in method_names():
        version = cell_version(name, "sdof").as_json()
        assert list(version) == list(NUMBERS)
        assert all(type(number) is int and number >= 1 for number in version.values())
    assert all(type(load_system(name).version) is int for name in registered_systems())


def test_the_packages_in_use_are_named_by_their_public_version() -> None:
    assert {"numpy", "scipy"} == set(cell_version("oracle", "sdof").packages)
    packages = cell_version("pinn", "sdof").packages
    assert {"numpy", "scipy", "torch"} <= set(packages)
    assert not any("+" in version for version in packages.values())


@pytest.mark.parametrize("number", NUMBERS)
def test_each_number_makes_stale_and_is_named(number: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    store = Store(tmp_path / "rows")
    store.prepare()
    for method in ("ls", "shooting"):
        save(store, described(method), scored(method, 3))
    assert [state for _, state, _ in standings(store)] == ["done", "done"]
    stored = cell_version("ls", "sdof").as_json()
    today = stored[number] + 1
    owner = {"method": load_method("ls"), "system": load_system("sdof"), "scoring": scoring}[number]
    monkeypatch.setattr(owner, "VERSION" if number == "scoring" else "version", today, raising=True)
    cell_version.cache_clear()
    by_label = {head.label: (state, why) for head, state, why in standings(store)}
    expected = ("stale", f"{number} version {stored[number]}, today {today}")
    assert by_label["ls"] == expected
    assert by_label["shooting"] == (("done", "") if number == "method" else expected)
    assert f"x {number} version {stored[number]}, today {today}" in store_page(store)
    assert cell_version("ls", "sdof").matches({**stored, number: today})
    assert (bound_version("sdof") == [1, 1]) == (number == "method")


def test_a_cell_without_numbers_is_stale_and_one_of_a_foreign_method_is_said_to_be(tmp_path: Path) -> None:
    store = Store(tmp_path / "rows")
    store.prepare()
    stored = save(store, described("ls"), scored("ls", 3))
    store.save(replace(stored, version={}))
    save(store, described("nobody"), scored("nobody", 3))
    found = {head.label: (state, why) for head, state, why in standings(store)}
    assert found["ls"][0] == "stale"
    assert f"method version not stated, today {load_method('ls').version}" in found["ls"][1]
    assert found["nobody"] == ("foreign", "no method nobody is installed here")


def test_a_change_under_a_condition_leaves_other_cells_current(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load_method("ls"), "parts", {"forces": 2, "unknown_start": 3})
    free = {"method": "ls", "settings": {}, "data": {"system": "sdof", "force": None}, "told": {}}
    before = cell_version("ls", "sdof").as_json()
    assert described_version(free).matches(before)
    forced = described_version({**free, "data": {"system": "sdof", "force": {"kind": "step"}}})
    assert forced.changed_since(before) == "forces version not stated, today 2"
    unknown = described_version({**free, "told": {"initial_state": "unknown", "prior": None}})
    assert unknown.as_json() == {**before, "unknown_start": 3}


def test_a_method_that_names_an_unknown_condition_is_refused_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load_method("ls"), "parts", {"weather": 2})
    with pytest.raises(InputError, match="its parts name weather; conditions are forces, prior, unknown_start"):
        described_version({"method": "ls", "settings": {}, "data": {"system": "sdof"}, "told": {}})

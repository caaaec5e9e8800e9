"""What is put together without Hydra is what Hydra composes."""

import json

import pytest

from bench.config import composition, files
from bench.config.choices import choices

CHOICES = [(group, name) for group in ("system", "prior", "disturbance") for name in choices(group)]
VARIANTS = [("method", name) for name in ("ls", "oracle", "ls_spline", "collocation_bootstrap")]


@pytest.mark.parametrize(("group", "name"), [*CHOICES, *VARIANTS])
def test_whole_files_are_merged_as_hydra_merges_them(group: str, name: str) -> None:
    """In the same order, too: a scenario's parameters stand in it as they are written."""
    composition.register_method(name if group == "method" else "ls")
    by_hydra = composition._by_hydra(((group, name),))[group]
    assert json.dumps(composition._whole_file(group, name)) == json.dumps(by_hydra)


def test_nothing_chosen_is_what_hydra_makes_of_nothing() -> None:
    composition.register_method("ls")
    assert json.dumps(composition.composed({})) == json.dumps(composition._by_hydra(()))


def test_a_file_that_speaks_hydras_language_is_left_to_hydra(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = {"one": "kind: sdof\nduration: ${snr}\n", "two": "# @package other\nkind: sdof\n", "three": "a: 1\n"}
    texts |= {"four": "defaults: [_self_, sdof]\n", "five": "defaults:\n  - prior: none\n"}
    monkeypatch.setattr(composition, "choices", lambda _: list(texts))
    for module in (composition, files):
        monkeypatch.setattr(module, "file_text", lambda _, name: texts[name])
    found = {name: composition._whole_file("system", name) is None for name in texts}
    assert found == {"one": True, "two": True, "three": False, "four": True, "five": True}

"""Print how large the project is, beside its goals: ``python -m tests.weight``.

Lines and files of each room, of the tests and the studies; tracked files; the largest of them; the size of results.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[1]
LARGEST = 12
"""How many of the largest files are named."""


@dataclass(frozen=True)
class Goal:
    """How much of what is wanted at most; a path counts where it starts with one of ``places``."""

    name: str
    most: int
    places: tuple[str, ...]
    unit: str = "lines"

    def holds(self, path: str) -> bool:
        """Decide whether a tracked file counts."""
        return path.startswith(self.places) and (self.unit != "lines" or path.endswith(".py"))


def rooms(folder: str, *names: str) -> tuple[str, ...]:
    """Return where the rooms of a folder stand, be they packages or single modules."""
    return tuple(f"{folder}/{name}{ending}" for name in names for ending in ("/", ".py"))


GOALS = (
    Goal("bench", 22_000, ("bench/",)),
    Goal("  errors, systems", 1_000, rooms("bench", "errors", "systems")),
    Goal("  contract", 1_000, rooms("bench", "contract")),
    Goal("  dynamics", 800, rooms("bench", "dynamics")),
    Goal("  scenario", 800, rooms("bench", "scenario")),
    Goal("  likelihood", 500, rooms("bench", "likelihood")),
    Goal("  information", 700, rooms("bench", "information")),
    Goal("  scoring", 700, rooms("bench", "scoring")),
    Goal("  store", 600, rooms("bench", "store")),
    Goal("  engine, isolation", 1_300, rooms("bench", "engine", "isolation")),
    Goal("  config", 600, rooms("bench", "config")),
    Goal("  records", 2_800, rooms("bench", "records")),
    Goal("  planning, atlas", 700, rooms("bench", "planning", "atlas")),
    Goal("  online, twin", 700, rooms("bench", "online", "twin")),
    Goal("  reporting", 4_200, rooms("bench", "reporting")),
    Goal(
        "  conformance, entrants, exchange, rounds",
        900,
        rooms("bench", "conformance", "entrants", "exchange", "rounds"),
    ),
    Goal("  face, commands", 1_700, rooms("bench", "face", "commands")),
    Goal("methods", 13_500, ("methods/",)),
    Goal("tests and studies", 20_000, ("tests/",)),
    Goal("  studies of sweeps", 500, rooms("tests/studies", "sweeps")),
    Goal("tracked files", 800, ("",), "files"),
    Goal("results/archive", 35_000, ("results/archive/",), "kB"),
)


def measure(goal: Goal, paths: Iterable[str]) -> tuple[int, int]:
    """Count what a goal limits, in its unit, and the files."""
    files = [path for path in paths if goal.holds(path)]
    if goal.unit == "files":
        return len(files), len(files)
    if goal.unit == "kB":
        return sum(map(size, files)) // 1000, len(files)
    return sum((REPOSITORY / path).read_bytes().count(b"\n") for path in files), len(files)


def size(path: str) -> int:
    """Return the size of a tracked file (bytes)."""
    return (REPOSITORY / path).stat().st_size


def main() -> int:
    """Print the measures; return 1 where the archive has become larger than it may be."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    paths = sorted(path for path in listed.stdout.split("\0") if path and (REPOSITORY / path).is_file())
    print(f"{'':<42}{'today':>8}{'goal':>8}        files")
    for goal in GOALS:
        today, files = measure(goal, paths)
        print(f"{goal.name:<42}{today:>8,}{goal.most:>8,} {goal.unit:<6}{files:>6}{'  reached' * (today <= goal.most)}")
    results = [path for path in paths if path.startswith("results/")]
    print(f"\nresults: {sum(map(size, results)) // 1000:,} kB in {len(results)} files\nlargest files (kB)")
    for path in sorted(paths, key=size, reverse=True)[:LARGEST]:
        print(f"{size(path) // 1000:>8,}  {path}")
    return int(any(measure(goal, paths)[0] > goal.most for goal in GOALS if goal.name == "results/archive"))


if __name__ == "__main__":
    sys.exit(main())

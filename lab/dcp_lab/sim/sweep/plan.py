"""The runs of a study: a scenario file with a table ``[sweep]``."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from dcp_spec.version import __version__

from dcp_lab.sim.scenario.definition import Scenario, ScenarioError
from dcp_lab.sim.scenario.loading import change, read_toml, scenario_codec, scenario_from
from dcp_lab.sim.scenario.provenance import Provenance

#: Maximum number of runs, so that a mistyped list does not plan for ever.
MOST_RUNS = 1_000_000
#: Keys of ``[sweep]`` that are not keys of the scenario.
_OWN = ("seeds", "zipped", "compare")


class Run(NamedTuple):
    """One run. ``cell``: the number of its combination. ``key`` identifies scenario, parameters, version and seed."""

    cell: int
    seed: int
    scenario: Scenario
    key: str


class Study(msgspec.Struct, frozen=True, kw_only=True):
    """A study. ``cells``: the values of each combination, by their dotted keys. ``raw``: the content of the file.

    ``compare``: the key for whose values paired differences are computed; None without keys.
    """

    raw: dict[str, Any]
    folder: str
    cells: tuple[dict[str, Any], ...]
    seeds: int
    compare: str | None = None

    @property
    def axes(self) -> tuple[str, ...]:
        """The keys that have several values."""
        return tuple(self.cells[0])

    def preceding(self) -> dict[int, int]:
        """Return for each cell the one with the preceding value of ``compare`` and otherwise equal values.

        Zipped lists vary together, so there it is the cell before it.
        """
        if self.compare is None:
            return {}
        if self.raw["sweep"].get("zipped", False):
            return {cell: cell - 1 for cell in range(1, len(self.cells))}
        values = self.raw["sweep"][self.compare]
        found = {}
        for number, cell in enumerate(self.cells):
            place = values.index(cell[self.compare])
            if place:
                found[number] = self.cells.index({**cell, self.compare: values[place - 1]})
        return found

    def runs(self, where: str) -> list[Run]:
        """Return all runs, cell by cell. Raises :class:`ScenarioError` with the values of an invalid combination."""
        found = []
        for number, cell in enumerate(self.cells):
            place = f"{where} ({', '.join(f'{key} = {value}' for key, value in cell.items())})"
            raw = {key: value for key, value in self.raw.items() if key != "sweep"}
            scenario = scenario_from(change(raw, cell, place), place, Path(self.folder))
            codec = scenario_codec(scenario, place)
            made = Provenance.of(scenario, codec)
            for seed in range(scenario.seed, scenario.seed + self.seeds):
                key = f"{made.scenario_sha256}/{__version__}/{seed}"
                found.append(Run(number, seed, msgspec.structs.replace(scenario, seed=seed), key))
        return found


def load_study(path: Path, seeds: int | None = None) -> Study:
    """Return the study in a TOML file; ``seeds`` replaces that of the file. Raises :class:`ScenarioError`."""
    return study_from(read_toml(path), path.parent, str(path), seeds)


def study_from(raw: dict[str, Any], folder: Path, where: str, seeds: int | None = None) -> Study:
    """Return the study with the content of a file. Raises :class:`ScenarioError`."""
    sweep = raw.get("sweep")
    if not isinstance(sweep, dict):
        raise ScenarioError(
            f"{where}: sweep: a study needs this table, with lists of values by the keys of the scenario"
        )
    axes = {key: values for key, values in sweep.items() if key not in _OWN}
    for key, values in axes.items():
        if not isinstance(values, list) or not values:
            raise ScenarioError(f"{where}: sweep.{key}: must be a list of at least one value (quote keys with dots)")
    # By default the lines of the plot.
    compare = sweep.get("compare", (list(axes)[1:2] or list(axes) or [None])[0])
    if compare is not None and compare not in axes:
        raise ScenarioError(f"{where}: sweep.compare: {compare!r} is not one of the keys {', '.join(axes)}")
    zipped, count = sweep.get("zipped", False), seeds if seeds is not None else sweep.get("seeds", 1)
    if not isinstance(zipped, bool):
        raise ScenarioError(f"{where}: sweep.zipped: must be true or false")
    if not isinstance(count, int) or isinstance(count, bool) or count < 1:
        raise ScenarioError(f"{where}: sweep.seeds: must be an integer of at least 1, not {count!r}")
    if zipped and len({len(values) for values in axes.values()}) > 1:
        raise ScenarioError(f"{where}: sweep: zipped lists must have the same length")
    combined = zip(*axes.values(), strict=True) if zipped else itertools.product(*axes.values())
    cells = tuple(dict(zip(axes, values, strict=True)) for values in itertools.islice(combined, MOST_RUNS + 1))
    if len(cells) * count > MOST_RUNS:
        raise ScenarioError(f"{where}: sweep: more than {MOST_RUNS:,} runs")
    return Study(raw=raw, folder=str(folder), cells=cells or ({},), seeds=count, compare=compare)


def short(key: str) -> str:
    """Return the last part of a dotted key."""
    return key.rpartition(".")[2]

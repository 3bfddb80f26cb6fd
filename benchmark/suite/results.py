# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""What was measured: series of samples with their names, as JSON and back."""

from __future__ import annotations

import json
import statistics
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Iterable

SCHEMA = 1


@dataclass
class Series:
    """Samples of one thing."""

    experiment: str
    what: str
    """What was measured, as 'write' or 'lookup'."""
    contender: str
    unit: str
    kind: str = ""
    """Kind of message, or bag."""
    x: float | None = None
    """Messages that were stored, or whatever the samples are drawn over."""
    values: list[float] = field(default_factory=list)

    @property
    def key(self) -> tuple[object, ...]:
        return self.experiment, self.what, self.contender, self.kind, self.x


@dataclass
class Results:
    """All series of a run, and what it ran on."""

    machine: dict[str, Any] = field(default_factory=dict)
    series: list[Series] = field(default_factory=list)
    failures: list[dict[str, str]] = field(default_factory=list)
    """What did not run: experiment, part, error."""
    seconds: dict[str, float] = field(default_factory=dict)
    """How long each experiment took."""

    def add(
        self,
        experiment: str,
        what: str,
        contender: str,
        values: Iterable[float],
        unit: str,
        kind: str = "",
        x: float | None = None,
    ) -> None:
        """Add samples, to those of the same name where there are some."""
        new = Series(experiment, what, contender, unit, kind, x)
        found = next((one for one in self.series if one.key == new.key), None)
        if found is None:
            self.series.append(new)
            found = new
        # Four digits are more than any of them is good for; the file stays small.
        found.values += [
            float(f"{value:.4g}") if value < 1e5 else float(round(value)) for value in values
        ]

    def find(
        self, experiment: str, what: str, contender: str, kind: str = "", x: float | None = None
    ) -> list[float]:
        """Return samples; [] = no samples."""
        key = (experiment, what, contender, kind, x)
        return next((one.values for one in self.series if one.key == key), [])

    def median(
        self, experiment: str, what: str, contender: str, kind: str = "", x: float | None = None
    ) -> float | None:
        """Return the median of samples; None = no samples."""
        values = self.find(experiment, what, contender, kind, x)
        return statistics.median(values) if values else None

    def of(self, experiment: str, what: str = "") -> list[Series]:
        """Return the series of an experiment."""
        return [s for s in self.series if s.experiment == experiment and what in ("", s.what)]

    def replace_experiments(self, later: Results) -> None:
        """Put what another run has measured in the place of the same experiments here."""
        names, ran = set(later.seconds), later.machine
        self.series = [s for s in self.series if s.experiment not in names]
        self.series += [s for s in later.series if s.experiment in names]
        self.failures = [f for f in self.failures if f["experiment"] not in names]
        self.failures += later.failures
        self.seconds.update(later.seconds)
        anew = dict.fromkeys(names, f"{ran['date']}, commit {ran['commit']}")
        self.machine["anew"] = {**self.machine.get("anew", {}), **anew}

    def save(self, path: Path) -> None:
        """Write the JSON, a series a line."""
        path.parent.mkdir(parents=True, exist_ok=True)
        head = {"schema": SCHEMA, "machine": self.machine, "seconds": self.seconds}
        head["failures"] = self.failures
        lines = ",\n".join(json.dumps(_short(one)) for one in self.series)
        text = json.dumps(head, indent=1)
        path.write_text(f'{text[:-2]},\n "series": [\n{lines}\n]}}\n', encoding="utf-8")

    @classmethod
    def load(cls, path: Path) -> Results:
        """Read what save has written."""
        data = json.loads(path.read_text(encoding="utf-8"))
        series = [Series(**one) for one in data["series"]]
        return cls(data["machine"], series, data["failures"], data["seconds"])

    @classmethod
    def load_all(cls, path: Path) -> Results:
        """Read the results of a full run, and beside them those of the viewer, where they are."""
        results, viewer = cls.load(path), path.with_name("viewer.json")
        if viewer.is_file():
            results.replace_experiments(cls.load(viewer))
        return results


def _short(one: Series) -> dict[str, Any]:
    found = {name: value for name, value in asdict(one).items() if value not in ("", None)}
    found["values"] = [int(v) if v == int(v) else v for v in one.values]
    return found


def quartiles(values: list[float]) -> tuple[float, float, float]:
    """Return the lower quartile, the median and the upper quartile of at least one value."""
    if len(values) < 2:
        return values[0], values[0], values[0]
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return low, middle, high

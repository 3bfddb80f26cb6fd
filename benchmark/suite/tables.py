# SPDX-FileCopyrightText: 2026 cassandra_ros authors
# SPDX-License-Identifier: BSD-3-Clause
"""The tables of a run as Markdown, by the names that stand in the pages."""

from __future__ import annotations

from typing import Callable, Sequence

from suite import paper, targets, viewer
from suite.messages import LARGE, NAMES
from suite.results import Results, quartiles

WRITERS = (
    *("packed", "packed import", "binary", "binary import", "ros", "ros import"),
    *("rosbag", "rosbag objects", "mcap", "mcap objects", "sqlite", "bare driver"),
)
READERS = ("packed", "binary", "ros", "rosbag", "mcap", "sqlite", "bare driver")


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Lay out a table, its first column to the left, the others to the right."""
    lines = [head, ["---", *["---:"] * (len(head) - 1)], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def number(value: float | None, digits: int = 3) -> str:
    """Show a number with so many digits, '-' for no number."""
    if value is None:
        return "-"
    if abs(value) >= 10 ** (digits - 1):
        return f"{value:,.0f}"
    return f"{value:,.{digits}g}"


def machine(results: Results) -> str:
    """Say what it ran on, and how long."""
    found, seconds = results.machine, sum(results.seconds.values())
    versions = ", ".join(f"{name} {version}" for name, version in found["versions"].items())
    changed = ", changed" if found["changed"] else ""
    text = (
        f"Run of {found['date']}, commit {found['commit']}{changed}: {found['cores']} cores of "
        f"{found['cpu']}, {found['memory_gb']} GB, {found['system']}; {versions}. It took "
        f"{seconds / 60:.0f} minutes."
    )
    anew = found.get("anew", {})
    for when in sorted(set(anew.values())):
        names = ", ".join(sorted(name for name in anew if anew[name] == when))
        text += f" By the run of {when}: {names}."
    failed = [f"{one['experiment']}, {one['part']}: {one['error']}" for one in results.failures]
    return text + "".join(f"\n\n**Failed:** {line}" for line in failed)


def done(results: Results) -> str:
    """Show what must be reached, and what is."""
    head, *rows = targets.rows(results)
    lines = [head, ["---", "---", "---", "---"], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _rates(results: Results, what: str, names: Sequence[str]) -> str:
    kinds = [kind for kind in NAMES if results.of("writing") and _has(results, kind)]
    rows = []
    for name in names:
        cells = [_rate(results, what, name, kind) for kind in kinds]
        if any(cell != "-" for cell in cells):
            rows.append([name, *cells])
    return markdown(["", *(NAMES[kind] for kind in kinds)], rows)


def _has(results: Results, kind: str) -> bool:
    return bool(results.find("writing", "write", "rosbag", kind))


def _rate(results: Results, what: str, name: str, kind: str) -> str:
    large = kind in (*LARGE, "scan")
    values = results.find("writing", f"{what} MB" if large else what, name, kind)
    if not values:
        return "-"
    low, middle, high = quartiles(values)
    spread = f" ({number(low)}–{number(high)})" if len(values) > 1 else ""
    return f"{number(middle)}{' MB/s' if large else ''}{spread}"


def writing(results: Results) -> str:
    """Show messages written a second; of large ones MB/s."""
    return _rates(results, "write", WRITERS)


def reading(results: Results) -> str:
    """Show messages read back as objects a second; of large ones MB/s."""
    return _rates(results, "read", READERS)


def arrays(results: Results) -> str:
    """Show messages a second of which fields were read as arrays."""
    kinds = sorted({one.kind for one in results.of("writing", "arrays")})
    names = [n for n in READERS if any(results.find("writing", "arrays", n, k) for k in kinds)]
    rows = [[n, *(number(results.median("writing", "arrays", n, k)) for k in kinds)] for n in names]
    return markdown(["", *(NAMES[kind] for kind in kinds)], rows)


def cpu(results: Results) -> str:
    """Show the processor time of a message, client + server, µs."""
    kinds = [kind for kind in NAMES if _has(results, kind)]
    rows = []
    for what, names in (("write", WRITERS), ("read", READERS)):
        for name in names:
            cells = []
            for kind in kinds:
                mine = results.median("writing", f"{what} client cpu", name, kind)
                theirs = results.median("writing", f"{what} server cpu", name, kind)
                cells.append(number(mine) + ("" if theirs is None else f" + {number(theirs)}"))
            if any(cell != "-" for cell in cells):
                rows.append([f"{what}, {name}", *cells])
    return markdown(["µs: client + server", *(NAMES[kind] for kind in kinds)], rows)


def bags(results: Results) -> str:
    """Show the size of real bags, as parts of the wire bytes, and what is imported a second."""
    names = ["packed", "binary", "ros", "rosbag", "rosbag bz2", "rosbag lz4", "mcap"]
    found = sorted({one.kind for one in results.of("bags")})
    rows = []
    for name in names:
        sizes = [_bag_size(results, name, bag) for bag in found]
        rates = [number(results.median("bags", "write", name, bag)) for bag in found]
        rows.append([name, *(f"{size}, {rate}/s" for size, rate in zip(sizes, rates))])
    return markdown(["size / wire bytes, messages written", *found], rows)


def _bag_size(results: Results, name: str, bag: str) -> str:
    """Show the size of a bag, and what of it grows with the messages."""
    size = number(results.median("bags", "size", name, bag))
    data = results.median("bags", "size of data alone", name, bag)
    return size if data is None else f"{size} (data alone {number(data)})"


def _by_count(
    results: Results,
    experiment: str,
    what: str,
    names: Sequence[str],
    head: str = "messages",
    kind: str = "",
) -> str:
    counts = sorted({one.x for one in results.of(experiment, what) if one.x is not None})
    rows = []
    for name in names:
        cells = [number(results.median(experiment, what, name, kind, x)) for x in counts]
        if any(cell != "-" for cell in cells):
            rows.append([name, *cells])
    return markdown([head, *(f"{x:,.0f}" for x in counts)], rows)


def growth(results: Results) -> str:
    """Show bytes on disk a message, by messages stored."""
    names = ("packed", "binary", "ros", "ros, indexes", "rosbag", "mcap", "sqlite")
    return _by_count(results, "growth", "size", names)


def lookups(results: Results) -> str:
    """Show median times of lookups, ms, and the paper's beside them."""
    names = ["packed", "binary", "ros", "bare SELECT, binary", "bare SELECT, ros"]
    table = _by_count(results, "lookups", "lookup", [*names, "rosbag", "mcap", "sqlite"])
    counts = sorted({one.x for one in results.of("lookups", "lookup")})
    for name, values in paper.LOOKUP_MS.items():
        cells = [number(values.get(int(x or 0))) for x in counts]
        table += f"\n| *{name} ({paper.SOURCE}, quoted)* | {' | '.join(cells)} |"
    return table


def small(results: Results) -> str:
    """Show small reads, ms and as multiples of the exact lookup."""
    reads = ("exact", *targets.SMALL_READS, *targets.STATEMENTS)
    names = [n for n in targets.FORMATS if any(s.contender == n for s in results.of("lookups"))]
    x = max((one.x or 0 for one in results.of("lookups")), default=0)
    rows = []
    for what in reads:
        cells = []
        for name in names:
            exact = results.median("lookups", "small read: exact", name, x=x)
            value = results.median("lookups", f"small read: {what}", name, x=x)
            times = targets.ratio(value, exact)
            cells.append(f"{number(value)} ms ({number(times)} x)")
        rows.append([what, *cells])
    return markdown([f"of {x:,.0f} messages", *names], rows)


def conditions(results: Results) -> str:
    """Show the seconds of conditions, and how many times faster than the bag scan that is."""
    series = results.of("conditions", "condition")
    kinds = list(dict.fromkeys(one.kind for one in series))
    names = list(dict.fromkeys(one.contender for one in series))
    found = {(s.kind, s.contender): quartiles(s.values)[1] for s in series}
    rows = []
    for kind in kinds:
        scan = found.get((kind.replace(", index", ""), "rosbag"))
        cells = []
        for name in names:
            value = found.get((kind, name))
            times = targets.ratio(scan, value)
            cells.append("-" if value is None else f"{number(value)} s ({number(times)} x)")
        rows.append([kind, *cells])
    return markdown(["seconds (x: faster than rosbag)", *names], rows)


def scans(results: Results) -> str:
    """Show the seconds of a scan, by messages, with the paper's."""
    table = _by_count(results, "clauses", "scan", ("rosbag", "mcap", "sqlite"))
    counts = sorted({one.x for one in results.of("clauses", "scan")})
    cells = [number(paper.BAG_SCAN_SEC.get(int(x or 0))) for x in counts]
    return f"{table}\n| *rosbag ({paper.SOURCE}, quoted)* | {' | '.join(cells)} |"


def sql(results: Results) -> str:
    """Show what SQL takes, and what others take for the same."""
    rows = []
    for one in results.of("sql"):
        low, middle, high = quartiles(one.values)
        spread = f" ({number(low)}–{number(high)})" if len(one.values) > 1 else ""
        rows.append(
            [
                ", ".join(filter(None, (one.what, one.kind, one.contender))),
                f"{one.x or 0:,.0f}",
                f"{number(middle)}{spread} {one.unit}",
            ]
        )
    return markdown(["", "messages", "median"], rows)


def live(results: Results) -> str:
    """Show what was recorded without loss, with the costs at that rate."""
    rows = []
    for held in results.of("live", "held"):
        rate = held.values[0]
        kind, name = held.kind, held.contender
        tried = max(s.x or 0 for s in results.of("live", "lost") if s.kind == kind)
        costs = [
            number(results.median("live", what, name, kind, int(rate)))
            for what in ("cpu", "server cpu", "memory", "drain")
        ]
        most = " (the most that was tried)" if rate == tried else ""
        rows.append([f"{name}, {kind}", f"{rate:,.0f}/s{most}", *costs])
    head = ["", "held", "its µs a message", "the server's", "memory, MB", "end after, s"]
    return markdown(head, rows)


def start(results: Results) -> str:
    """Show how long programs take to start, and what people wait for at the beginning."""
    rows = []
    for one in results.of("start", "wall"):
        low, middle, high = quartiles(one.values)
        spread = f"{number(middle)} ({number(low)}–{number(high)})"
        cpu = [
            number(results.median("start", what, one.contender))
            for what in ("client cpu", "server cpu")
        ]
        rows.append([one.contender, spread, *cpu])
    return markdown(["s", "wall", "client's processor", "server's"], rows)


def new_tables(results: Results) -> str:
    """Show how long the table of one topic takes, ms, by the number of topics."""
    steps = sorted({one.x or 0 for one in results.of("start", "table")})
    rows = []
    for way in ("together", "one by one"):
        cells = []
        for x in steps:
            cpu = [
                number(results.median("start", f"table, {side} cpu", way, x=x))
                for side in ("client", "server")
            ]
            cells.append(
                f"{number(results.median('start', 'table', way, x=x))} ({' + '.join(cpu)})"
            )
        rows.append([way, *cells])
    head = ["ms a table (client + server)", *(f"the {x:,.0f}th" for x in steps)]
    return markdown(head, rows)


def writers(results: Results) -> str:
    """Show what several writers store a second together."""
    return _by_count(results, "writers", "write", targets.FORMATS, "writers", "imu")


def cluster(results: Results) -> str:
    """Show one node and three beside each other."""
    names = [n for n in targets.FORMATS if any(s.contender == n for s in results.of("cluster"))]
    nodes = max((one.x or 0 for one in results.of("cluster")), default=0)
    rows = []
    for what, unit in (("write", "msg/s"), ("read", "msg/s"), ("lookup", "ms")):
        for name in names:
            one, label = results.median("writing", what, name, "imu"), what
            if what == "lookup":
                label = "lookup (on one node among the paper's messages)"
                counts = [s.x or 0 for s in results.of("lookups", "lookup")]
                one = results.median("lookups", what, name, x=max(counts)) if counts else None
            many = results.median("cluster", what, name, "imu", nodes)
            rows.append([f"{label}, {name}, {unit}", number(one), number(many)])
    return markdown(["Imu", "one node", f"{nodes:.0f} nodes, factor {nodes:.0f}"], rows)


def of_viewer(results: Results) -> str:
    """Show what the viewer answers of a day of ten million messages, and how soon."""
    return markdown(["asked", "must be", "median", ""], viewer.rows(results))


TABLES: dict[str, Callable[[Results], str]] = {
    "machine": machine,
    "done": done,
    "writing": writing,
    "reading": reading,
    "arrays": arrays,
    "cpu": cpu,
    "bags": bags,
    "growth": growth,
    "lookups": lookups,
    "small": small,
    "conditions": conditions,
    "scans": scans,
    "sql": sql,
    "live": live,
    "start": start,
    "new tables": new_tables,
    "writers": writers,
    "cluster": cluster,
    "viewer": of_viewer,
}


def fill(text: str, results: Results) -> str:
    """Return a page with the tables between its markers made anew.

    A table stands between lines <!-- bench:NAME --> and <!-- /bench:NAME -->.

    Raises:
        ValueError: A marker has no end, or there is no such table.
    """
    parts: list[str] = []
    while True:
        before, begin, rest = text.partition("<!-- bench:")
        parts.append(before)
        if not begin:
            return "".join(parts)
        name, _, rest = rest.partition(" -->")
        end = f"<!-- /bench:{name} -->"
        _, found, text = rest.partition(end)
        if not found or name not in TABLES:
            raise ValueError(f"{begin}{name}: no {end}, or no such table")
        parts.append(f"{begin}{name} -->\n{TABLES[name](results)}\n{end}")

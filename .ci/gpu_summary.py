"""Writes README.md of a folder of results of `run`: what dominates, shares of copy bandwidth, waits, failures. Needs Python 3.8, nothing else.

usage: python3 summary.py FOLDER
"""

import csv
import json
import re
import sys
from pathlib import Path


def rows(path):
    """Rows of a CSV file; none where it is missing."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def table(head, body):
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(map(str, row)) + " |" for row in body])


def number(text):
    return float(text) if text else 0.0


def percent(share):
    return f"{100 * share:.0f} %"


def milliseconds(seconds):
    return f"{1e3 * number(seconds):.3g}"


def engineering(value):
    """A value with three digits and a prefix."""
    value = float(value)
    if value == 0:
        return "0 "
    for factor, prefix in [(1e12, "T"), (1e9, "G"), (1e6, "M"), (1e3, "k"), (1, ""), (1e-3, "m"), (1e-6, "u")]:
        if abs(value) >= factor:
            return f"{value / factor:.3g} {prefix}"
    return f"{value * 1e9:.3g} n"


def device_section(folder):
    found = rows(folder / "device" / "device.csv")
    body = [[r["quantity"], engineering(r["median"]) + r["unit"], engineering(r["min"]), engineering(r["max"])] for r in found]
    return ["## Device", table(["quantity", "median", "least", "largest"], body)] if found else []


def checks_section(folder):
    lines = []
    status = {r["step"]: r["status"] for r in rows(folder / "steps.csv")}
    for log in sorted(folder.glob("compare_*.log")):
        text = log.read_text(errors="replace")
        breaches = [line for line in text.splitlines() if "BREACH" in line]
        error = next((line for line in text.splitlines() if line.startswith("error")), None)
        ended = status.get(log.stem, "no status")
        result = f"{len(breaches)} breaches" if breaches else error or ("within bounds" if ended == "done" else ended)
        lines.append([log.stem, result])
    log = folder / "tests.log"
    if log.exists():
        text = log.read_text(errors="replace")
        passed = len(re.findall(r"^test .* \.\.\. ok$", text, re.M))
        failed = re.findall(r"^test (.*) \.\.\. FAILED$", text, re.M)
        ended = "" if re.search("^test result:", text, re.M) else f"; {status.get('tests', 'no status')} before the others"
        lines.append(["tests", f"{passed} passed, {len(failed)} failed{ended}" + "".join(f"<br>`{name}`" for name in failed)])
    return ["## Checks", table(["check", "result"], lines)] if lines else []


def step_section(folder):
    parts = []
    for path in sorted(folder.glob("step_*/step.csv")):
        stages = rows(path.parent / "step_stages.csv")
        for row in rows(path):
            key = ("scene", "scale", "kind")
            of_row = [s for s in stages if all(s[k] == row[k] for k in key)]
            of_row.sort(key=lambda s: -number(s["seconds_median"]))
            seconds = number(row["seconds_median"])
            parts.append(f"### {row['scene']}, scale {row['scale']}, {row['kind']}")
            parts.append(
                f"{int(row['cells']):,} cells, {number(row['unknowns']):,.0f} pressures, {int(row['markers']):,} markers, {int(row['nodes']):,} nodes: "
                f"{milliseconds(seconds)} ms a sub-step ({milliseconds(row['seconds_min'])} to {milliseconds(row['seconds_max'])}), "
                f"{engineering(row['cells_per_second'])}cells/s. "
                f"{number(row['waits']):.1f} waits, {number(row['submissions']):.1f} submissions, {number(row['dispatches']):.0f} dispatches, "
                f"{engineering(row['bytes_up'])}B up, {engineering(row['bytes_down'])}B down; nothing queued for {percent(number(row['idle_seconds']) / seconds)} "
                f"of the time. {engineering(row['device_bytes'])}B of buffers."
            )
            body = [
                [
                    s["stage"],
                    s["where"],
                    milliseconds(s["seconds_median"]),
                    percent(number(s["seconds_median"]) / seconds),
                    f"{number(s['dispatches']):.0f}",
                    f"{number(s['waits']):.1f}",
                ]
                for s in of_row
            ]
            parts.append(table(["stage", "where", "ms", "of the sub-step", "dispatches", "waits"], body))
    return ["## Sub-steps"] + parts if parts else []


def solve_section(folder):
    found = [row for path in folder.glob("solve_*/solve.csv") for row in rows(path)]
    found.sort(key=lambda r: (int(r["grid"]), r["formulation"], -float(r["tolerance"])))
    body = [
        [
            r["grid"],
            f"{int(r['active_cells']):,}",
            r["formulation"],
            f"{float(r['tolerance']):.0e}",
            r["status"],
            r["iterations"],
            f"{milliseconds(r['seconds_median'])} ({milliseconds(r['seconds_min'])}, {milliseconds(r['seconds_max'])})",
            engineering(r["cells_per_second"]),
            percent(number(r["share_of_copy_bandwidth"])) if r["share_of_copy_bandwidth"] else "",
            r["waits"],
            r["dispatches"],
            percent(number(r["idle_seconds"]) / number(r["seconds_median"])),
            engineering(r["device_bytes"]) + "B",
        ]
        for r in found
    ]
    head = ["grid", "cells", "form", "tolerance", "status", "iterations", "ms", "cells/s", "of copy bandwidth", "waits", "dispatches", "nothing queued", "buffers"]
    return ["## Solves", table(head, body)] if body else []


def main():
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_dir():
        sys.exit(__doc__)
    folder = Path(sys.argv[1])
    device = folder / "device" / "device.json"
    machine = json.loads(device.read_text()) if device.exists() else {}
    title = machine.get("adapter", "unknown adapter")
    facts = [f"{name}: {machine[key]}" for name, key in [("driver", "driver"), ("CPU", "cpu"), ("measured", "measured"), ("sources", "sources")] if machine.get(key)]
    steps = [[r["step"], r["status"], r["seconds"], r["peak_host_mib"], r["peak_device_mib"]] for r in rows(folder / "steps.csv")]
    parts = [f"# {title}", "; ".join(facts)]
    parts += device_section(folder) + checks_section(folder) + solve_section(folder) + step_section(folder)
    parts += ["## Steps of the measurement", table(["step", "status", "s", "peak host MiB", "peak device MiB"], steps)]
    (folder / "README.md").write_text("\n\n".join(part for part in parts if part) + "\n")


main()

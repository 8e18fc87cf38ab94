"""Tables of CSV files in Markdown pages: no number in them is typed by hand. Needs Python 3.8, nothing else.

    tables.py [PAGE ..]           writes the tables of the pages anew: all of them, or on an error none
    tables.py --check [PAGE ..]   changes nothing; exit code 1 if a table is not what its CSV file says
    tables.py --test              runs the tests at the end of this file

Without PAGE: docs/measured/*.md. A table is a block

    <!-- table
    {"file": "solve/solve.csv", "where": {"precision": "mixed"},
     "columns": [["cells", "{active_cells}"], ["seconds (least, largest)", "{seconds_median} ({seconds_min}, {seconds_max})"]]}
    -->
    <!-- end of table -->

`file` is below docs/measured, or the folder of --dir. `where` selects rows by text or number. A column is a heading and a text with CSV columns in
braces; the text is dropped in rows where all of these are empty. The caption comes from the JSON file of the bench. A table whose CSV
file is missing stays as it is.
"""

import argparse
import csv
import json
import os
import re
import sys
import tempfile
import unittest
from pathlib import Path

BLOCK = re.compile(r"^<!-- table\n(.*?)^-->\n(.*?)^<!-- end of table -->$", re.DOTALL | re.MULTILINE)
HEAD = re.compile(r"^<!-- table$", re.MULTILINE)
ROOT = Path(__file__).resolve().parent.parent


class Refused(Exception):
    """Bad input: the message says what is wrong, where and what to do."""


def number(cell):
    """The value of a cell, or None for text."""
    return float(cell) if re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", cell) else None


def rounded(cell):
    """A number with three digits, or all digits of an integer; other text as it is."""
    value = number(cell)
    if value is None or re.fullmatch(r"[+-]?\d+", cell):
        return cell.replace("|", "\\|")
    if value == 0:
        return "0"
    # The power after rounding: 0.9996 is 1.00.
    digits, power = f"{value:.2e}".split("e")
    power = int(power)
    if -3 <= power < 4:
        return f"{value:.{max(2 - power, 0)}f}"
    return f"{digits.rstrip('0').rstrip('.')}e{power}"


def plain(value):
    """A JSON number without an exponent and without a trailing .0."""
    return f"{value:.15f}".rstrip("0").rstrip(".")


def span(values):
    return values[0] if values[0] == values[-1] else f"{values[0]} to {values[-1]}"


def caption(path):
    """Date, version, adapter, threads and load from the JSON file of the bench; None without one."""
    words = path.stem.split("_")
    # solve_growth.csv belongs to solve.json.
    names = ["_".join(words[:n]) + ".json" for n in range(len(words), 0, -1)]
    found = [path.with_name(name) for name in names if path.with_name(name).exists()]
    if not found:
        return None
    bench = json.loads(found[0].read_text(encoding="utf-8"))
    # Rows of several runs: the first and the last date, the range of the rest.
    parts = bench.get("parts", [bench])
    text = span([part["measured"].split("T")[0] for part in parts]) + f", cutwater {bench['cutwater']}"
    if "sources" in bench:
        text += f" ({bench['sources']})"
    bandwidths = sorted(part["copy_bandwidth"]["median"] for part in parts if part.get("copy_bandwidth"))
    if "adapter" in bench and bandwidths:
        bandwidth = span([f"{1e-9 * bandwidth:.1f}" for bandwidth in bandwidths])
        text += f", {bench['adapter']}, copy bandwidth {bandwidth} GB/s"
    text += f", {plain(bench['threads'])} CPU threads"
    if "cpu" in bench:
        text += f" ({bench['cpu']})"
    loads = sorted(part["load"] for part in parts if part.get("load") is not None)
    if loads:
        text += f" at a load of {span([plain(load) for load in loads])}"
    return text + "."


def read(path):
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.reader(file, strict=True))
    except csv.Error as problem:
        raise Refused(f"{path}: {problem}. Measure it again.") from None
    if not rows:
        raise Refused(f"{path}: the file is empty. Measure it again, or remove it to keep the table.")
    return rows[0], [dict(zip(rows[0], row)) for row in rows[1:]]


def filled(text, row):
    """A cell of the table: the text with the row's numbers in place of its braces."""
    names = re.findall(r"{(.*?)}", text)
    if all(row[name] == "" for name in names):
        return ""
    return re.sub(r"{(.*?)}", lambda match: rounded(row[match[1]]), text)


def table(text, folder, old):
    """The lines between the JSON of a block and its end."""
    try:
        wanted = json.loads(text)
    except json.JSONDecodeError as problem:
        raise Refused(f"the block is not JSON: {problem}. Write file, columns and optionally where.") from None
    if not {"file", "columns"} <= wanted.keys() <= {"file", "columns", "where"}:
        raise Refused(f"the block has the keys {sorted(wanted)}. Write file, columns and optionally where.")
    path = folder / wanted["file"]
    if not path.exists():
        return old, False
    heads, rows = read(path)
    where = {name: value if isinstance(value, str) else json.dumps(value) for name, value in wanted.get("where", {}).items()}
    for name in list(where) + [name for _, text in wanted["columns"] for name in re.findall(r"{(.*?)}", text)]:
        if name not in heads:
            raise Refused(f"{wanted['file']} has no column {name!r}. Its columns are {', '.join(heads)}.")

    def selected(row):
        return all(row[name] == value or number(row[name]) is not None and number(row[name]) == number(value) for name, value in where.items())

    rows = [row for row in rows if selected(row)]
    columns = wanted["columns"]
    lines = ["| " + " | ".join(head for head, _ in columns) + " |", "|" + "---|" * len(columns)]
    lines += ["| " + " | ".join(filled(text, row) for _, text in columns) + " |" for row in rows]
    if not rows:
        lines = ["*None.*"]
    if caption(path):
        lines += ["", f"*{caption(path)}*"]
    return "\n".join(lines) + "\n", True


def renewed(page, folder):
    """The text of a page with its tables written anew, and the files that are missing."""
    text = page.read_text(encoding="utf-8")
    missing = []
    if len(HEAD.findall(text)) != len(BLOCK.findall(text)):
        raise Refused(f"{page}: a table block does not end. Close its JSON with --> and the table with <!-- end of table -->.")

    def write(block):
        try:
            lines, found = table(block[1], folder, block[2])
        except Refused as problem:
            line = text.count("\n", 0, block.start()) + 1
            raise Refused(f"{page}:{line}: {problem}") from None
        if not found:
            missing.append(json.loads(block[1])["file"])
        return f"<!-- table\n{block[1]}-->\n{lines}<!-- end of table -->"

    return text, BLOCK.sub(write, text), missing


def replace(page, text):
    """Writes a page whole or not at all."""
    handle, name = tempfile.mkstemp(dir=page.parent)
    with open(handle, "w", encoding="utf-8") as file:
        file.write(text)
    os.chmod(name, page.stat().st_mode)
    os.replace(name, page)


def main():
    parser = argparse.ArgumentParser(description="Writes the tables of Markdown pages from CSV files.")
    parser.add_argument("pages", nargs="*", type=Path, metavar="PAGE", help="default: docs/measured/*.md")
    parser.add_argument("--dir", type=Path, default=ROOT / "docs/measured", help="folder of the CSV files")
    parser.add_argument("--check", action="store_true", help="change nothing; exit code 1 if a table is out of date")
    parser.add_argument("--test", action="store_true", help="run the tests of this script")
    options = parser.parse_args()
    if options.test:
        unittest.main(argv=sys.argv[:1])
    pages = options.pages or sorted((ROOT / "docs/measured").glob("*.md"))
    try:
        changes = [(page, *renewed(page, options.dir)) for page in pages]
    except (Refused, OSError) as problem:
        print(f"error: {problem}", file=sys.stderr)
        return 2
    wrong = 0
    for page, old, new, missing in changes:
        for file in missing:
            print(f"{page}: {file} is missing")
        if options.check:
            wrong += len(missing)
            if old != new:
                pairs = zip(old.splitlines(), new.splitlines())
                at = next((n for n, (a, b) in enumerate(pairs, 1) if a != b), len(new.splitlines()))
                print(f"{page}:{at}: the table is not what its CSV file says. Run .ci/tables.py.")
                wrong += 1
        elif old != new:
            replace(page, new)
            print(page)
    return 1 if wrong else 0


class Tests(unittest.TestCase):
    PAGE = """# Speed
<!-- table
{"file": "solve/solve_growth.csv", "where": {"precision": "mixed", "tolerance": 1e-8},
 "columns": [["cells", "{grid}"], ["seconds (least)", "{median} ({min})"], ["order", "{order}"]]}
-->
old
<!-- end of table -->
After it.
"""
    TABLE = """grid,precision,tolerance,median,min,order
20,mixed,0.00000001,0.123456,0.1,
20,f32,1e-8,9,9,9
40,mixed,1e-4,9,9,9
80,mixed,1e-8,12.3456,0.00001,1.5
"""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        (self.folder / "solve").mkdir()
        self.page = self.folder / "speed.md"

    def page_from(self, page, table=TABLE, bench=None):
        (self.folder / "solve/solve_growth.csv").write_text(table)
        if bench:
            (self.folder / "solve/solve.json").write_text(json.dumps(bench))
        self.page.write_text(page)
        return renewed(self.page, self.folder)[1]

    def test_numbers_have_three_digits(self):
        for cell, expected in {
            "0.000975": "9.75e-4", "-0.000012345": "-1.23e-5", "0.00097": "9.7e-4", "0.00000001": "1e-8", "157498.5": "1.57e5", "0.0042": "0.00420",
            "0.9994": "0.999", "0.9996": "1.00", "9.996": "10.0", "1234.5678": "1235", "0.0": "0", "157498": "157498", "a|b": "a\\|b", "": "",
        }.items():
            self.assertEqual(rounded(cell), expected, cell)

    def test_rows_columns_and_caption(self):
        bench = {"cutwater": "0.1.0", "adapter": "an adapter", "measured": "2026-11-22T05:00:00Z", "threads": 2, "load": 0.5, "copy_bandwidth": {"median": 2.5e9}}
        rows = "| cells | seconds (least) | order |\n|---|---|---|\n| 20 | 0.123 (0.100) |  |\n| 80 | 12.3 (1e-5) | 1.50 |\n"
        told = "\n*2026-11-22, cutwater 0.1.0, an adapter, copy bandwidth 2.5 GB/s, 2 CPU threads at a load of 0.5.*\n"
        new = self.page_from(self.PAGE, bench=bench)
        self.assertEqual(new, self.PAGE.replace("old\n", rows + told))
        self.assertEqual(self.page_from(new), new)
        # Without an adapter: a run on the CPU.
        bench = {"cutwater": "0.1.0", "sources": "abc", "measured": "2026-11-22T05:00:00Z", "threads": 2, "cpu": "a CPU", "load": 0.5}
        told = "*2026-11-22, cutwater 0.1.0 (abc), 2 CPU threads (a CPU) at a load of 0.5.*"
        self.assertIn(told, self.page_from(self.PAGE, bench=bench))
        # Several runs.
        parts = [("22", 2.5e9, 0.5), ("23", 4e9, 2.83), ("24", 1.2e9, 1)]
        bench["adapter"] = "an adapter"
        bench["parts"] = [{"measured": f"2026-11-{day}T05:00:00Z", "load": load, "copy_bandwidth": {"median": rate}} for day, rate, load in parts]
        told = "*2026-11-22 to 2026-11-24, cutwater 0.1.0 (abc), an adapter, copy bandwidth 1.2 to 4.0 GB/s, 2 CPU threads (a CPU) at a load of 0.5 to 2.83.*"
        self.assertIn(told, self.page_from(self.PAGE, bench=bench))

    def test_no_rows_and_no_file(self):
        heads = self.TABLE.splitlines()[0] + "\n"
        self.assertEqual(self.page_from(self.PAGE, heads), self.PAGE.replace("old", "*None.*"))
        other = self.PAGE.replace("solve/solve_", "solve/other_")
        self.assertEqual(self.page_from(other), other)
        self.assertEqual(renewed(self.page, self.folder)[2], ["solve/other_growth.csv"])

    def test_bad_input_is_refused(self):
        for old, new, told in [
            ("{grid}", "{grids}", "no column 'grids'"), ('"precision"', '"precisions"', "no column 'precisions'"), ("columns", "colums", "has the keys"),
            ("<!-- end of table -->\n", "", "does not end"), ("-->\nold", "old", "does not end"), ("{\"file", "{file", "is not JSON"),
        ]:
            with self.assertRaisesRegex(Refused, f"speed.md.*{told}"):
                self.page_from(self.PAGE.replace(old, new))
        for table, told in [("", "is empty"), ('grid\n"20\n', "unexpected end")]:
            with self.assertRaisesRegex(Refused, f"solve_growth.csv.*{told}"):
                self.page_from(self.PAGE, table)


if __name__ == "__main__":
    sys.exit(main())

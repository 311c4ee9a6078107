"""Measure which statements of the book would fail on another machine.

    python book/portable.py [PAGE ...] [--runs N]

runs pages, those that compute something if none is named, under
perturbations the size of a rounding error (`perturbation.py`): each 20
times in all, 5 times if all its statements are exact, or N times more.
`portable.json` keeps how often each
statement failed; a page of which the code changes is measured afresh.

    python book/portable.py --changed

runs each page once that has not been run so often as it is now, and keeps
nothing: `make test` does so.
"""

import argparse
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import perturbation

BOOK = Path(__file__).parent
LEDGER = BOOK / "portable.json"
RUNS = 20
"""Of a page with a live statement."""
RUNS_OF_EXACT = 5
"""Of a page whose statements are all exact, or read from records."""


def pages() -> dict[str, Path]:
    """Return the pages with statements, by name."""
    modules = {path.stem for path in BOOK.glob("checks/*.py")}
    found = sorted([*BOOK.glob("*.ipynb"), *BOOK.glob("notes/*.ipynb")])
    return {page.stem: page for page in found if page.stem in modules}


def statements(name: str) -> str:
    """Return the module with a page's statements."""
    return (BOOK / "checks" / f"{name}.py").read_text("utf-8")


def computing() -> list[str]:
    """Return the pages with a live or an exact statement."""
    return [name for name in pages() if needed(name)]


def needed(name: str) -> int:
    """Return how many runs a page must have had."""
    if "\n@live" in statements(name):
        return RUNS
    return RUNS_OF_EXACT if "\n@exact" in statements(name) else 0


def digest(page: Path) -> str:
    """Return what changes with the code of a page and its statements.

    A cell that only shows an interactive figure computes nothing, and
    what a cell with an exercise makes no other cell and no statement uses.
    How the lines are divided into cells changes nothing.
    """
    cells = json.loads(page.read_text("utf-8"))["cells"]
    code = [
        line
        for cell in cells
        if cell["cell_type"] == "code"
        and not {"toy", "exercise"} & set(cell["metadata"].get("tags", []))
        for line in "".join(cell["source"]).splitlines()
        if line.strip()
    ]
    text = json.dumps([code, statements(page.stem)])
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def ledger() -> dict[str, Any]:
    """Return what has been measured, by page."""
    return json.loads(LEDGER.read_text("utf-8")) if LEDGER.exists() else {}


def entry_of(name: str, page: Path) -> dict[str, Any]:
    """Return what was measured of a page as it is now."""
    new = {
        "digest": digest(page),
        "statements": 0,
        "runs": {},
        "failed": {},
    }
    known = ledger().get(name, new)
    return known if known["digest"] == new["digest"] else new


def runs(entry: dict[str, Any]) -> int:
    """Return how often a page was run."""
    return sum(entry["runs"].values())


def add(entry: dict[str, Any], outcomes: list[dict[str, str]]) -> None:
    """Count one more run of a page."""
    from offairl_lite.runs.records import processor

    failed = [each["name"] for each in outcomes if each["evidence"]]
    for counts, names in (("runs", [processor()]), ("failed", failed)):
        for name in names:
            entry[counts][name] = entry[counts].get(name, 0) + 1
    entry["statements"] = max(entry["statements"], len(outcomes))


def perturbed(todo: list[tuple[int, str]]) -> Iterator[tuple[str, list]]:
    """Run pages, side by side; yield each with what became of it."""
    there, build = pages(), BOOK.parent / "build"
    build.mkdir(exist_ok=True)
    scratch = tempfile.TemporaryDirectory(prefix="portable-", dir=build)
    pool = ProcessPoolExecutor(int(os.environ.get("JOBS", 1)))
    with scratch as folder, pool:
        place = Path(folder), BOOK
        waiting = {
            pool.submit(perturbation.run, there[name], number, *place): name
            for number, name in todo
        }
        for future in as_completed(waiting):
            yield waiting[future], future.result()


def measure(names: list[str], more: int | None, changed: bool) -> int:
    """Run pages and say what failed; return 1 if anything ever did."""
    there, entries, todo = pages(), {}, []
    for name in names or computing():
        if name not in there:
            raise SystemExit(f"no page {name}: {' '.join(there)}")
        entry = entry_of(name, there[name])
        done = runs(entry)
        left = needed(name) - done
        if changed and left <= 0:
            continue
        entries[name] = entry
        last = done + (1 if changed else more or left)
        todo += [(number, name) for number in range(done + 1, last + 1)]
    for name, outcomes in perturbed(sorted(todo)) if todo else ():
        add(entries[name], outcomes)
        failed = [each for each in outcomes if each["evidence"]]
        print(f"{name}: {len(failed)} of {len(outcomes)} fail", flush=True)
        for each in failed:
            print(f"  {each['name']}: {each['evidence']}", flush=True)
        if not changed:
            kept = {k: v for k, v in ledger().items() if k in there}
            kept[name] = entries[name]
            text = json.dumps(kept, indent=1, sort_keys=True)
            LEDGER.write_text(text + "\n", "utf-8")
    for name, entry in entries.items():
        count = f"{entry['statements']} statements, {runs(entry)} runs"
        print(f"{name:32}{count:>25}", *entry["failed"].items())
    return int(any(entry["failed"] for entry in entries.values()))


def main() -> int:
    """Measure pages as the command line says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("pages", nargs="*", help="such as 02_gail_and_dac")
    parser.add_argument("--runs", type=int, help="how many more")
    parser.add_argument("--changed", action="store_true")
    arguments = parser.parse_args()
    return measure(arguments.pages, arguments.runs, arguments.changed)


if __name__ == "__main__":
    sys.exit(main())

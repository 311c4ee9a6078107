"""Run pages of the book, and mark those that did not go well here.

    python book/execute.py run FOLDER PAGE ... [--jobs N]

runs each book/…/PAGE.ipynb in the copy of the book in FOLDER, N at a time.
Whatever happens, the copy can be rendered: a page with a statement that
does not hold here, or with a cell that failed, says so at its top. If all
its cells ran, FOLDER has an empty file PAGE.run beside it.

    python book/execute.py report FOLDER

lists the marked pages of FOLDER, with what to do.
"""

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

# Reading a notebook imports this, which takes a second or two to build a
# grammar of web addresses, and no page needs it.
sys.modules["rfc3987_syntax"] = None  # type: ignore[assignment]

import nbformat  # noqa: E402
from nbclient import NotebookClient  # noqa: E402

import kernels  # noqa: E402

MARK = "offairl"
"""Where a notebook's metadata says what did not go well."""


def run(page: Path, folder: Path, timeout: int | None = None) -> bool:
    """Run a page in a copy of the book; return whether all cells ran."""
    # In one write, since other processes print there, too.
    print(f"Running {page}\n", end="", flush=True)
    notebook, copy = nbformat.read(page, as_version=4), folder / page
    done = copy.with_name(f"{copy.name}.run")
    done.unlink(missing_ok=True)
    place = {"metadata": {"path": str(copy.parent)}}
    client = NotebookClient(
        notebook, timeout=timeout, kernel_name="python3", resources=place
    )
    failure = ""
    try:
        client.execute()
    except Exception as error:  # Whatever it is, the text can be read.
        name = getattr(error, "ename", "") or type(error).__name__
        words = (getattr(error, "evalue", "") or str(error)).split()
        failure = f"{name}: {' '.join(words)}"[:300]
    mark(notebook, failure)
    nbformat.write(notebook, copy)
    if not failure:
        done.touch()
    return not failure


def failed_statements(notebook: nbformat.NotebookNode) -> tuple[list, int]:
    """Return the statements that do not hold, and the number of all."""
    outcomes = [
        outcome
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        for outcome in output.get("metadata", {}).get("checks", [])
    ]
    return [each for each in outcomes if each["evidence"]], len(outcomes)


def mark(notebook: nbformat.NotebookNode, failure: str) -> None:
    """Say at the top of a page what did not go well, if anything."""
    failed, count = failed_statements(notebook)
    if failure:
        short = f"stopped at an error, {failure}"
        long = (
            f"This page stopped at an error on this machine, `{failure}`. "
            "Its text is complete, but figures, tables and checks from "
            "there on are missing."
        )
    elif failed:
        short = f"{len(failed)} of {count} statements do not hold"
        long = (
            f"On this machine {len(failed)} of the {count} statements of "
            "this page did not hold. Its last lines say which, and by how "
            "much."
        )
    else:
        return
    notebook.metadata[MARK] = short
    title = notebook.cells[0]
    first, _, rest = title.source.partition("\n")
    title.source = f"{first}\n\n:::{{warning}}\n{long}\n:::\n{rest}"


def report(folder: Path) -> str:
    """Return which pages are marked, and what to do; empty if none is."""
    lines = []
    for path in sorted((folder / "book").rglob("*.ipynb")):
        notebook = nbformat.read(path, as_version=4)
        code = [cell for cell in notebook.cells if cell.cell_type == "code"]
        short = notebook.metadata.get(MARK)
        ran = any(cell.execution_count for cell in code)
        if code and not ran and not short:
            short = "did not run"  # Killed, perhaps, for want of memory.
        if short:
            page = path.relative_to(folder).with_suffix("")
            lines.append(f"  {page}: {short}")
    if not lines:
        return ""
    return "\n".join(
        [
            "These pages are marked at their top:",
            *lines,
            "The rest of the book is as it should be. If a statement does "
            "not hold here, our margin is wrong: please report it with the "
            "last lines of its page and the name of your processor. If a "
            "page stopped at an error, mend the cause and run `make book` "
            "again. It runs the pages that stopped once more.",
        ]
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run some pages, or report on all."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    some = commands.add_parser("run", help="run pages")
    some.add_argument("folder", type=Path)
    some.add_argument("pages", type=Path, nargs="+", metavar="page")
    some.add_argument("--jobs", type=int, default=1, help="at a time")
    some.add_argument("--timeout", type=int, help="seconds of a cell")
    everything = commands.add_parser("report", help="list marked pages")
    everything.add_argument("folder", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "run":
        kernels.fork()
        with ThreadPoolExecutor(options.jobs) as pool:
            ran = [
                pool.submit(run, page, options.folder, options.timeout)
                for page in options.pages
            ]
        return 0 if all(page.result() for page in ran) else 1
    if text := report(options.folder):
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())

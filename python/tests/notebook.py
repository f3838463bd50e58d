"""Runs the notebooks of the package's examples, each in a folder of its own."""

import sys
import tempfile
from pathlib import Path

import jupytext
import nbclient

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "notebooks"


def main() -> int:
    """Run every notebook; an error in a cell ends with its text."""
    notebooks = sorted(EXAMPLES.glob("*.py"))
    if not notebooks:
        sys.exit(f"no notebook in {EXAMPLES}")
    for path in notebooks:
        print(f"notebook {path.name}", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            notebook = jupytext.read(path)
            client = nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": folder}})
            client.execute()
        pictures = [out for cell in notebook.cells for out in cell.get("outputs", []) if "image/png" in out.get("data", {})]
        if not pictures:
            sys.exit(f"{path.name} shows no picture")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Runs the notebooks and writes their outputs in place, the same bytes for the same outputs.

`python -m notebooks.execute` runs all of them, `python -m notebooks.execute FILE ...` some.
"""

import argparse
import base64
import io
import tempfile
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image
from traitlets.config import Config

FOLDER = Path(__file__).parent
NOTEBOOKS = sorted(FOLDER.glob("[0-9]*.ipynb"))
TIMEOUT = 900
"""Longest time for one cell, seconds; a busy machine takes ten times as long as a quiet one."""


def execute(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Run all cells in a new kernel and an empty folder; the notebook itself gets the outputs.

    Raises:
      CellExecutionError: a cell failed.
    """
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as sockets:
        place = {"metadata": {"path": folder}}
        # Over files, not ports: nobody else can talk to the kernel.
        over = {"transport": "ipc", "ip": str(Path(sockets) / "kernel")}
        NotebookClient(
            notebook, kernel_name="python3", timeout=TIMEOUT, resources=place,
            record_timing=False, coalesce_streams=True, config=Config({"KernelManager": over}),
        ).execute()  # fmt: skip
    return notebook


def tidy(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """Leave out what depends on the machine or the hour: versions, times, random ids of cells."""
    notebook.metadata = nbformat.from_dict({
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    })  # fmt: skip
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    number = 0
    for index, cell in enumerate(notebook.cells):
        cell.id = f"cell-{index:02d}"
        cell.metadata = nbformat.from_dict({})
        if cell.cell_type != "code":
            continue
        number += 1
        cell.execution_count = number
        for output in cell.outputs:
            if "execution_count" in output:
                output.execution_count = number
            if "metadata" in output:
                output.metadata = nbformat.from_dict({})
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = smaller(output.data["image/png"])
                output.data.pop("text/plain", None)  # words beside it, with an address in memory
    return notebook


def smaller(picture: str) -> str:
    """A PNG in base64 without its transparency, packed well."""
    image = Image.open(io.BytesIO(base64.b64decode(picture)))
    if image.mode == "RGB":
        return picture
    stream = io.BytesIO()
    image.convert("RGB").save(stream, format="PNG", optimize=True)
    return base64.b64encode(stream.getvalue()).decode()


def errors_of(notebook: nbformat.NotebookNode) -> list[str]:
    """What the cells wrote to the error stream: warnings."""
    return [
        output.text
        for cell in notebook.cells
        for output in cell.get("outputs", [])
        if output.output_type == "stream" and output.name == "stderr"
    ]


def read(path: Path) -> nbformat.NotebookNode:
    """A notebook from its file."""
    return nbformat.read(path, as_version=4)


def main() -> None:
    """Run the notebooks that are named, or all, and write them."""
    parser = argparse.ArgumentParser(description="Run notebooks and write their outputs in place.")
    parser.add_argument("paths", nargs="*", type=Path, default=NOTEBOOKS)
    for path in parser.parse_args().paths:
        start = time.perf_counter()
        notebook = tidy(execute(read(path)))
        nbformat.validate(notebook)
        path.write_text(nbformat.writes(notebook) + "\n", encoding="utf-8")
        kilobytes = path.stat().st_size / 1000
        print(f"{path.name}: {time.perf_counter() - start:.0f} s, {kilobytes:.0f} kB", flush=True)
        for text in errors_of(notebook):
            print(text)


if __name__ == "__main__":
    main()

"""Execute a notebook of the book, in its folder: no cell fails, the pictures appear. Its file holds no output.

    check_notebook.py FILE.ipynb
"""

import pathlib
import sys

import nbclient
import nbformat

from checks import require

path = pathlib.Path(sys.argv[1])
notebook = nbformat.read(path, as_version=4)
cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
require(cells and not any(cell.outputs or cell.execution_count for cell in cells), f"{path.name}: no output is stored")
nbclient.NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(path.parent)}}).execute()
kinds = [kind for cell in cells for output in cell.outputs for kind in output.get("data", {})]
require(kinds.count("image/png") == 4 and kinds.count("text/html") == 2, f"{path.name}: {len(cells)} cells, their pictures and tables")

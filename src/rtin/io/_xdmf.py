"""XDMF: written as one text file, read through meshio (an extra), also where HDF5 files are beside.

The placement is an XML comment: the elements that XDMF has for notes stop meshio from reading.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import json
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from rtin.io._cells import Cells, FileMesh, cut, find_tags
from rtin.io._numbers import require_plausible
from rtin.io._placement import PlacedMesh

__all__ = ["read", "xdmf"]

_MARK = re.compile(rb"<!-- rtin (\{.*\}) -->")


def xdmf(placed: PlacedMesh) -> bytes:
    """Return ``placed`` as an XDMF 3 file that holds all its numbers itself."""
    n_triangles = len(placed.triangles)
    stored = placed.as_json().replace("--", "-\\u002d")  # -- would end the comment
    topology = _item(placed.triangles, "Int", 4)
    geometry = _item(placed.vertices, "Float", 8)
    parts = [
        f'<?xml version="1.0"?>\n<!-- rtin {stored} -->\n',
        '<Xdmf Version="3.0">\n<Domain>\n<Grid Name="mesh" GridType="Uniform">\n',
        f'<Topology TopologyType="Triangle" NumberOfElements="{n_triangles}" '
        f'NodesPerElement="3">\n{topology}</Topology>\n',
        f'<Geometry GeometryType="XYZ">\n{geometry}</Geometry>\n',
        "" if placed.tags is None else _attribute("tag", placed.tags),
        "</Grid>\n</Domain>\n</Xdmf>\n",
    ]
    return "".join(parts).encode("ascii")


def _attribute(name: str, values: NDArray[np.int32]) -> str:
    item = _item(values, "Int", 4)
    return f'<Attribute Name="{name}" AttributeType="Scalar" Center="Cell">\n{item}</Attribute>\n'


def _item(values: NDArray[Any], kind: str, precision: int) -> str:
    """Return an array as text, each number with as many digits as reading it back exactly takes."""
    shape = " ".join(map(str, values.shape))
    rows = values.reshape(len(values), -1).tolist()
    lines = "".join(" ".join(map(repr, row)) + "\n" for row in rows)
    return (
        f'<DataItem DataType="{kind}" Dimensions="{shape}" Format="XML" '
        f'Precision="{precision}">\n{lines}</DataItem>\n'
    )


def read(path: Path) -> FileMesh:
    """Return what is in an XDMF file of version 2 or 3 with one grid."""
    meshio_xdmf, h5py = _require("meshio.xdmf"), _require("h5py")
    content = path.read_bytes()
    _check_sizes(ET.fromstring(content), path, h5py)
    with _silence():
        mesh = meshio_xdmf.read(path)
    flat = np.asarray(mesh.points, dtype=np.float64)
    points = np.zeros((len(flat), 3))
    points[:, : flat.shape[1]] = flat
    triangles, tags = cut(_blocks(mesh), points)
    found = _MARK.search(content)
    return FileMesh(points, triangles, None if found is None else json.loads(found[1]), tags)


@contextlib.contextmanager
def _silence() -> Iterator[None]:
    """Keep meshio from printing, and NumPy from warning of text that is no number.

    There are then fewer numbers than the file says, which is an error.
    """
    with (
        contextlib.redirect_stderr(io.StringIO()),
        contextlib.redirect_stdout(io.StringIO()),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore", DeprecationWarning)
        yield


def _blocks(mesh: Any) -> list[Cells]:  # noqa: ANN401
    """Return the cells of a meshio mesh, with the tags that all of them have."""
    joined = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items()}
    tags = find_tags(joined)
    ends = np.cumsum([len(block.data) for block in mesh.cells])
    if tags is None:
        return [Cells(block.type, block.data) for block in mesh.cells]
    parts = np.split(tags, ends[:-1])
    return [Cells(b.type, b.data, part) for b, part in zip(mesh.cells, parts, strict=True)]


def _check_sizes(root: ET.Element, path: Path, h5py: Any) -> None:  # noqa: ANN401
    """Raise ValueError where an HDF5 file that is named cannot hold what it announces."""
    for item in root.iter("DataItem"):
        name, separator, place = (item.text or "").strip().partition(":")
        if item.get("Format") != "HDF" or not separator:
            continue
        beside = path.parent / name
        if not beside.is_file():
            raise ValueError(f"the numbers are in {name}, which is not beside it")
        with h5py.File(beside, "r") as file:
            require_plausible(int(file[place].size), beside.stat().st_size)


def _require(module: str) -> Any:  # noqa: ANN401
    """Return the module, or raise an ImportError that says how to install it."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        raise ImportError(
            "reading XDMF needs meshio and h5py, of which one is not installed; "
            'pip install "rtin[fem]"'
        ) from None

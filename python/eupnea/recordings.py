"""Recordings: columns of a Parquet file as numpy arrays or as data frames."""

from __future__ import annotations

import importlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas
    import polars
    import pyarrow

#: Name of the metadata of a recording's file that has its provenance.
PROVENANCE = b"eupnea"


def _need(package: str) -> None:
    """Check that a package of data frames is installed."""
    try:
        importlib.import_module(package)
    except ImportError:
        raise ImportError(f"this data frame needs {package}: pip install './python[frames]'") from None


class Recording:
    """A recording in a Parquet file, one row for each control tick (docs/FILES.md describes the columns).

    Args:
        path: The file.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: pyarrow is missing.
        ValueError: The file is not a recording.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        if not self.path.exists():
            raise FileNotFoundError(f"there is no recording {self.path}: check the path")
        try:
            import pyarrow
            from pyarrow import parquet
        except ImportError:
            raise ImportError("recordings need pyarrow, which pip install ./python installs") from None
        try:
            self.table: pyarrow.Table = parquet.read_table(self.path)
        except (pyarrow.ArrowException, OSError) as error:
            raise ValueError(f"{self.path} is not a recording: {error}") from None
        if PROVENANCE not in (self.table.schema.metadata or {}):
            raise ValueError(f"{self.path} is a Parquet file, but not a recording of the trainer")

        self._bytes = self.path.read_bytes()

    def file(self, path: str | os.PathLike[str]) -> Path:
        """Write the recording, byte for byte as it was read, and return the path."""
        written = Path(path)
        written.write_bytes(self._bytes)
        return written

    @property
    def provenance(self) -> dict[str, Any]:
        """Plant, settings, seed and program with which it was recorded."""
        decoded: dict[str, Any] = json.loads((self.table.schema.metadata or {})[PROVENANCE])
        return decoded

    def __len__(self) -> int:
        """Return the number of ticks."""
        return int(self.table.num_rows)

    def __getitem__(self, column: str) -> Any:
        """Return a column as a numpy array, without a copy where it can.

        Raises:
            KeyError: There is no such column.
        """
        if column not in self.table.column_names:
            raise KeyError(f"{column!r}: the recording has {', '.join(self.table.column_names)}")
        return self.table.column(column).to_numpy()

    def pandas(self) -> pandas.DataFrame:
        """Return the recording as a data frame of pandas.

        Raises:
            ImportError: pandas is missing.
        """
        _need("pandas")
        frame: pandas.DataFrame = self.table.to_pandas()
        return frame

    def polars(self) -> polars.DataFrame:
        """Return the recording as a data frame of polars, without a copy.

        Raises:
            ImportError: polars is missing.
        """
        _need("polars")
        import polars

        frame = polars.from_arrow(self.table)
        assert isinstance(frame, polars.DataFrame)
        return frame

    def __repr__(self) -> str:
        return f"Recording({str(self.path)!r}, {len(self)} ticks)"

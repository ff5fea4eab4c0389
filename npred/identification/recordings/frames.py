"""Tables that pandas reads: Parquet, as one file or as the folder of a data set, and workbooks of Excel and Calc."""

import re
from importlib import import_module
from pathlib import Path
from typing import Any

from npred.base import json_files
from npred.base.errors import required
from npred.identification.recordings import decoding
from npred.identification.recordings.table import NamedColumns, expanded, pd
from npred.identification.recordings.text import Text

LARGE = re.compile(r"struct|map|(large_)?binary")  # types of columns that hold no numbers


class Parquet(NamedColumns):
    """Parquet. Cells that hold a vector, as `action` of a robot, are columns action[0], action[1], ...

    Of a folder the files below `data`, or below itself, are read in the order of their names.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        required("recording parquet", "pyarrow", "pyarrow", "parquet")
        folder = path / "data" if (path / "data").is_dir() else path
        files = sorted(folder.rglob("*.parquet")) if path.is_dir() else [json_files.regular(path)]
        with decoding(path, "Parquet"):
            columns = expanded(pd.concat(map(_numbers, files), ignore_index=True))
        if len(files) > 1:
            self.notes.append(f"the folder holds {len(files)} files; their rows are counted through.")
        self.counted(columns)


def _numbers(file: Path) -> Any:
    """The columns of a file without those of images and structures."""
    schema = import_module("pyarrow.parquet").read_schema(file)
    kinds = {field.name: str(field.type) for field in schema}
    return pd.read_parquet(file, columns=[name for name, kind in kinds.items() if not LARGE.match(kind)])


class Workbook(Text):
    """The largest sheet of a workbook, as the table of text that it would be saved as."""

    separator = "\t"

    def lines(self) -> list[str]:
        """The rows of the sheet."""
        required("recording xlsx", "python_calamine", "python-calamine", "excel")
        with decoding(self.path, "a workbook"):
            book = pd.read_excel(json_files.regular(self.path), None, header=None, dtype=object, engine="calamine")
        name, sheet = max(book.items(), key=lambda item: item[1].size, default=("", pd.DataFrame()))
        if len(book) > 1:
            self.notes.append(f"the workbook holds {len(book)} sheets; {name} is read, the largest.")
        return ["\t".join(map(_cell, row)) for row in sheet.itertuples(index=False)]


def _cell(value: Any) -> str:
    """A cell as text; a missing one is empty."""
    return "" if value is None or value != value else " ".join(str(value).split())

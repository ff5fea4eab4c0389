"""Tables that pandas reads: Parquet with vectors in its cells, folders of it, and workbooks."""

import zipfile

import numpy as np
import pandas as pd
import pytest

from npred.base.errors import ConfigError
from npred.identification import recordings


def frame(first: int = 0) -> pd.DataFrame:
    """Thirty rows of a robot: two joints, an image that is left out."""
    k = np.arange(first, first + 30.0)
    columns = {
        "action": np.stack([k, -k], axis=1).astype(np.float32),
        "observation.state": np.stack([k / 2, k], axis=1),
    }
    table = {name: list(values) for name, values in columns.items()}
    return pd.DataFrame(table | {"timestamp": np.arange(30) / 30, "image": [{"bytes": b"png"}] * 30})


def test_vectors_in_the_cells_of_parquet_are_columns(tmp_path):
    pytest.importorskip("pyarrow")
    frame().to_parquet(tmp_path / "log.parquet")
    names = ["action[0]", "action[1]", "observation.state[0]", "observation.state[1]", "timestamp"]
    assert recordings.opened(tmp_path / "log.parquet").columns() == names
    t, values, rows = recordings.read(tmp_path / "log.parquet", ["action[1]"]).series["action[1]"]
    np.testing.assert_allclose(t, np.arange(30) / 30)
    assert values.tolist() == [-k for k in range(30)] and rows[0] == 1


def test_a_data_set_is_a_folder_of_files_in_order(tmp_path):
    pytest.importorskip("pyarrow")
    for k in (1, 0):
        (tmp_path / f"data/chunk-00{k}").mkdir(parents=True)
        frame(30 * k).to_parquet(tmp_path / f"data/chunk-00{k}/file.parquet")
    (tmp_path / "meta").mkdir()
    pd.DataFrame({"task": ["fold"]}).to_parquet(tmp_path / "meta/tasks.parquet")
    read = recordings.read(tmp_path, ["action[0]"])
    assert read.series["action[0]"].values.tolist() == list(range(60))
    assert read.notes[1] == "the folder holds 2 files; their rows are counted through."


def test_what_is_no_parquet_is_refused_in_one_line(tmp_path):
    pytest.importorskip("pyarrow")
    (tmp_path / "log.parquet").write_bytes(b"t,u\n0,1\n")
    with pytest.raises(ConfigError, match=r"log.parquet: expected Parquet, got: .*; check the file$"):
        recordings.opened(tmp_path / "log.parquet")


def workbook(path, sheets):
    """A workbook of numbers and texts, as few bytes as a reader takes."""
    relations = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    main = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    with zipfile.ZipFile(path, "w") as file:
        named = "".join(f'<sheet name="{name}" sheetId="{k}" r:id="r{k}"/>' for k, name in enumerate(sheets, 1))
        file.writestr("xl/workbook.xml", f'<workbook {main} xmlns:r="{relations}"><sheets>{named}</sheets></workbook>')
        links = "".join(
            f'<Relationship Id="r{k}" Type="{relations}/worksheet" Target="worksheets/{k}.xml"/>'
            for k in range(1, len(sheets) + 1)
        )
        package = "http://schemas.openxmlformats.org/package/2006/relationships"
        root = f'<Relationship Id="r1" Type="{relations}/officeDocument" Target="xl/workbook.xml"/>'
        file.writestr("_rels/.rels", f'<Relationships xmlns="{package}">{root}</Relationships>')
        file.writestr("xl/_rels/workbook.xml.rels", f'<Relationships xmlns="{package}">{links}</Relationships>')
        for k, rows in enumerate(sheets.values(), 1):
            cells = "".join(
                "<row>" + "".join(
                    f"<c><v>{cell}</v></c>" if isinstance(cell, int | float)
                    else f'<c t="inlineStr"><is><t>{cell}</t></is></c>' for cell in row
                ) + "</row>" for row in rows
            )  # fmt: skip
            file.writestr(f"xl/worksheets/{k}.xml", f"<worksheet {main}><sheetData>{cells}</sheetData></worksheet>")


def test_the_largest_sheet_of_a_workbook_is_read_as_a_table_of_text(tmp_path):
    pytest.importorskip("python_calamine")
    rows = [["made by a bench"], ["Time [s]", "u [V]", "mode"], *([k / 10, 1.5 * k, "auto mode"] for k in range(9))]
    workbook(tmp_path / "log.xlsx", {"about": [["a", 1]], "data": rows})
    read = recordings.read(tmp_path / "log.xlsx", ["u"])
    np.testing.assert_allclose(read.series["u"].t, np.arange(9) / 10)
    assert read.series["u"].values.tolist() == [1.5 * k for k in range(9)] and read.series["u"].rows[0] == 3
    assert read.units == {"u": "V"} and "holds 2 sheets; data is read, the largest" in read.notes[-1]

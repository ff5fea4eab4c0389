"""C files from skeletons: which lines stay, and whose names are written."""

import pytest

from npred.base.errors import NpredError
from npred.exports import c_files


def test_a_condition_that_no_variant_is_stays_for_the_compiler():
    text = "#if A\n1\n#ifdef B\n2\n#else\n3\n#endif\n#else\n4\n#endif\n#if defined C\n5\n#endif\n"
    assert c_files.decided(text, {"A": True}) == "1\n#ifdef B\n2\n#else\n3\n#endif\n#if defined C\n5\n#endif\n"
    assert c_files.decided(text, {"A": False}) == "4\n#if defined C\n5\n#endif\n"


def test_names_types_and_parts_are_written_in(tmp_path, monkeypatch):
    text = '#include "npred.h"\n#include "numbers.h"\nnpred_real npred_step(int NPRED_NX); /* by npred 1.0 */\n'
    (tmp_path / "file.c").write_text(text)
    monkeypatch.setattr(c_files, "FOLDER", tmp_path)
    written = c_files.filled("file.c", "tank", "float", included={"numbers": "static const int npred_kept = 1;"})
    assert written == (
        '#include "tank.h"\nstatic const int npred_kept = 1;\nfloat tank_step(int TANK_NX); /* by npred 1.0 */\n'
    )


def test_a_file_that_does_not_compile_is_told_in_one_line(tmp_path):
    if not c_files.compiler():
        pytest.skip("no C compiler on this machine")
    (tmp_path / "wrong.c").write_text("int f(void) { return none; }\n")
    with pytest.raises(NpredError, match=r"^export c: expected sources that compile, got: [^\n]*; report it$"):
        c_files.build([tmp_path / "wrong.c"], tmp_path / "wrong.so", "c")

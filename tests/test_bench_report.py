"""The benchmark's LaTeX table and figure."""

from npred.stages import bench_report

ROW = {"runtime": "compiled", "batch": 1, "matches": None, "copies": None, "device": "cpu", "speedup_published": 2.0,
       "speedup_compiled": None, "p95_us": 2.0, "p999_us": 3.0, "max_us": 4.0}  # fmt: skip


def rows():
    measured = [("euler_python", 0.1, 60.0, 1.1), ("rk4", 0.1, 1.25, 3.8e-4), ("rk4", 0.01, 4200.0, 1e-12)]
    return [ROW | {"predictor": p, "dx": dx, "median_us": t, "eps_sup": eps} for p, dx, t, eps in measured]


def test_latex_has_a_line_a_predictor_and_a_pair_of_columns_a_dx():
    text = bench_report.latex([*rows(), rows()[1] | {"batch": 1024}, rows()[1] | {"matches": "front"}])
    lines = text[text.index(r"\midrule") : text.index(r"\bottomrule")].splitlines()[1:]
    assert lines == [
        r"euler\_python & compiled & 60.0 & $1.1 \cdot 10^{0}$ & --- & --- \\",
        r"rk4 & compiled & 1.2 & $3.8 \cdot 10^{-4}$ & 4200 & $1.0 \cdot 10^{-12}$ \\",
    ]
    assert r"\begin{tabular}{llrrrr}" in text


def test_a_gpu_row_says_whether_copies_are_in_it():
    row = rows()[0] | {"runtime": "torch", "device": "cuda", "copies": True}
    assert "torch, cuda, with copies" in bench_report.latex([row])


def test_figure_is_the_same_for_the_same_rows(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        bench_report.draw(tmp_path / name, rows())
    assert (tmp_path / "a/front.svg").read_bytes() == (tmp_path / "b/front.svg").read_bytes()

"""A benchmark for people: 80 columns by default, all of it on request; and the time of each predictor's call."""

from typing import Any

from npred.stages.bench import timing_tables


def row(predictor: str, runtime: str, dx: float, us: float, **more: Any) -> dict[str, Any]:
    plain = {"batch": 1, "matches": None, "device": "cpu", "copies": None, "eps_sup": 0.0184}
    times = {"median_us": us, "p95_us": us, "p999_us": us, "max_us": us}
    return {"predictor": predictor, "runtime": runtime, "dx": dx, **plain, **times, "speedup_published": None,
            "speedup_compiled": 1.5} | more  # fmt: skip


RESULT = {
    "calls": 20_000,
    "hardware": {"cpu": "A processor with a long name, 2.70 GHz"},
    "crossover": [{"sentence": "A network pays."}],
    "stops": {"sentence": "The machine stops."},
    "rows": [
        row("published", "python", 0.001, 14321.0),
        row("rk4", "compiled", 0.01, 1.0),
        row("rk4", "compiled", 0.001, 9.5),
        row("deeponet", "torch", 0.001, 864.0),
        row("deeponet", "fused", 0.001, 6.9),
        row("deeponet", "torch", 0.001, 90.0, device="cuda:0", copies=False, batch=1024),
        row("euler", "compiled", 0.125, 0.7, matches="deeponet"),
        row("euler", "compiled", 0.25, 0.5, matches="front", eps_sup=None),
    ],
}


def test_the_summary_fits_80_columns_and_leaves_out_what_only_a_figure_needs():
    lines = timing_tables.summary(RESULT, 80).splitlines()
    assert max(map(len, lines)) <= 80 and "…" not in "".join(lines)
    assert lines[2].split() == ["predictor", "runtime", "dx", "batch", "µs", "ε", "sup"]
    assert len([line for line in lines if line.startswith("euler")]) == 1
    assert lines[-2:] == ["A network pays.", "The machine stops."]


def test_the_details_have_every_row_with_its_tails_and_ratios():
    text = timing_tables.details(RESULT)
    assert "p99.9" in text and "× O(nx²) sums" in text and "published" not in text
    assert "torch cuda:0 without copies" in text
    assert len(text.splitlines()) == 3 + len(RESULT["rows"]) + 3


def test_a_call_is_the_fastest_runtimes_at_the_finest_grid():
    assert timing_tables.fastest(RESULT, ["deeponet", "fno"], "rk4") == {"numerical": 9.5, "deeponet": 6.9}
    assert timing_tables.fastest({"rows": []}, ["deeponet"], "rk4") == {}

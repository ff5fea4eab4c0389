"""The tables of the report: what each stage's result says, as rows."""

from typing import Any

import numpy as np

from npred.figures.evaluation_data import OF
from npred.figures.latency import label
from npred.figures.notation import quantity
from npred.figures.style import words
from npred.figures.table import Column, Grid
from npred.plants import Plant

Row = dict[str, Any]
ERRORS = {"mse": "mean square", "eps_sup": "ε sup", "eps_kappa": "ε_{κ}", "rel_l2": "relative L²"}
TIMES = {"median_us": "median µs", "p95_us": "95 %", "p999_us": "99.9 %", "max_us": "max"}


def accuracy(models: dict[str, Row], kind: str) -> Grid:
    """Errors of each network on held-out rows of the first kind, and the sup error on fresh ones."""
    networks = {name: row for name, row in models.items() if row["eps_sup"]}
    rows = [
        {"predictor": words(name)} | {key: row[key] for key in ERRORS} | {"fresh": row["fresh"]["eps_sup"]}
        for name, row in networks.items()
    ]
    columns = [Column(head, key, digits=2) for key, head in ERRORS.items()]
    fresh = Column("ε sup, fresh rollouts", "fresh", digits=2)
    title = f"Errors on held-out samples of {OF[kind]}"
    return Grid("accuracy", title, [Column("predictor", "predictor"), *columns, fresh], rows)


def kinds(evaluated: Row) -> Grid:
    """Errors of each network on held-out rows of each kind."""
    rows = [
        {"predictor": words(name), "kind": OF[kind], "rows": evaluated["kinds"][kind]["rows"]} | found
        for name, row in evaluated["models"].items()
        if row["eps_sup"]
        for kind, found in row["kinds"].items()
    ]
    columns = [Column("predictor", "predictor"), Column("held out", "kind"), Column("samples", "rows", ",d")]
    columns += [Column(head, key, digits=2) for key, head in ERRORS.items()]
    above = Column(f"above ε sup of {OF[evaluated['held_out_kind']]}", "above", ".1%")
    return Grid("kinds", "Errors by kind of row", [*columns, above], rows)


def loops(models: dict[str, Row]) -> Grid:
    """What the closed loops of each contender do."""
    numerical = models["numerical"]
    numerical_converged = np.array(numerical["map"]["converged"] if numerical["map"] else [], dtype=bool)
    columns = [
        Column("predictor", "predictor"),
        Column("radius, median", "median", digits=2),
        Column("worst", "worst", digits=2),
        Column(f"converged of {numerical['radius']['cases']}", "converged", "d"),
        Column("settles ×", "settles", ".2f"),
        Column(f"map, of {numerical_converged.sum()}", "kept", "d"),
        Column("radius, loop shown", "radius", digits=2),
        Column("D̂ at its end", "D_hat", ".3f"),
        Column("sup |P(1, t) − X(t + D)|", "in_loop", digits=2),
    ]
    return Grid(
        "loops", "Closed loops", columns, [_loops(name, row, numerical_converged) for name, row in models.items()]
    )


def _loops(name: str, row: Row, numerical_converged: np.ndarray) -> Row:
    cells = {key: row["radius"][key] for key in ("median", "worst")}
    cells["converged"] = converged(row)
    settles = "" if row["settle_ratio"] is None else row["settle_ratio"]
    kept = int((np.array(row["map"]["converged"]) & numerical_converged).sum()) if row["map"] else ""
    end = {"radius": row["figure1"]["radius"], "D_hat": row["figure1"]["D_hat_end"]}
    return {"predictor": words(name)} | cells | {"settles": settles, "kept": kept} | end | {"in_loop": row["in_loop"]}


def converged(row: Row) -> int:
    """How many of a contender's cases converge."""
    return round(row["radius"]["converged"] * row["radius"]["cases"])


def training(trained: dict[str, Row]) -> Grid:
    """The size of each network and how it was trained."""
    rows = [
        {"network": words(name)} | {key: row[key] for key in ("parameters", "samples", "epochs", "loss")}
        for name, row in trained.items()
    ]
    counts = [Column(name, name, ",d") for name in ("parameters", "samples", "epochs")]
    return Grid(
        "training", "Training", [Column("network", "network"), *counts, Column("last loss", "loss", digits=2)], rows
    )


def speed(rows: list[Row]) -> Grid:
    """Every row of the benchmark."""
    columns = [Column("predictor", "name"), Column("dx", "dx", ".3g"), Column("batch", "batch", "d")]
    columns += [Column(head, key, digits=3) for key, head in TIMES.items()]
    columns += [
        Column("ε sup", "eps_sup", digits=2),
        Column("× O(nx²) sums", "published", digits=3),
        Column("× Euler", "euler", digits=3),
    ]
    return Grid("speed", "Time of a call", columns, [_speed(row) for row in rows if row["matches"] != "front"])


def _speed(row: Row) -> Row:
    name = label(row) if row["matches"] is None else f"{label(row)} (ε of {words(row['matches'])})"
    ratios = {"published": row["speedup_published"], "euler": row["speedup_compiled"]}
    return row | {"name": name} | {key: "" if value is None else value for key, value in ratios.items()}


def by_dx(rows: list[Row]) -> Grid:
    """Table I of [DAPF]: median and error at batch 1, a pair of columns for each dx."""
    single = [row for row in rows if row["batch"] == 1 and row["matches"] is None]
    steps = sorted({row["dx"] for row in single}, reverse=True)
    found: dict[str, Row] = {}
    for row in single:
        mine = found.setdefault(label(row), {"name": label(row)} | {f"{q}{dx}": "" for q in ("t", "e") for dx in steps})
        mine |= {f"t{row['dx']}": row["median_us"], f"e{row['dx']}": row["eps_sup"]}
    pairs = [[Column(f"µs, dx = {dx:.3g}", f"t{dx}", digits=3), Column("ε sup", f"e{dx}", digits=2)] for dx in steps]
    columns = [Column("predictor", "name"), *(column for pair in pairs for column in pair)]
    return Grid("bench", "Median of a call by dx", columns, list(found.values()))


def outside(plant: Plant, coverage: dict[str, Row]) -> Grid:
    """The range of the data, and the share of each network's loop steps outside it."""
    names = list(next(iter(coverage.values()))["outside"])
    columns = [Column("quantity", "quantity"), Column("data from", "low", digits=3), Column("to", "high", digits=3)]
    columns += [Column(f"outside, {words(name)}", name, ".2%") for name in names]
    rows = [
        {"quantity": quantity(plant, name), "low": found["data"][0], "high": found["data"][1]} | found["outside"]
        for name, found in coverage.items()
    ]
    return Grid("coverage", "Loops outside the data", columns, rows)

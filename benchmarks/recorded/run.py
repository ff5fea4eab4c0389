"""`npred identify` on real recordings, by its command line, beside the referee's answers of logs.toml.

    python benchmarks/recorded/run.py DATA_FOLDER [NAME...] [--jobs 1] [--fast]

DATA_FOLDER holds each file as its repository does, under owner+name/path (README.md here). Prints a Markdown table, and
each log's sentences below it. Where the referee says that a log holds enough for a controller, the pipeline goes on
unchanged to `npred plants check`, `npred generate`, which simulates its loops, `npred tune` and `npred export`;
`--fast` leaves these four out.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import plants

HERE = Path(__file__).resolve().parent
LOGS = tomllib.loads((HERE / "logs.toml").read_text(encoding="utf-8"))
LIMIT = 300  # s of a command
AFTER = {
    "check": ["plants", "check", "answer.toml"],
    "simulate": ["generate", "answer.toml", "--jobs", "1"],
    "tune": ["tune", "answer.toml", "--free", "strength", "--set", "tune.evaluations=20", "--jobs", "1"],
    "export": ["export", "controller", "answer.toml", "--predictor", "rk4", "-o", "controller"],
}


def flags(log: dict[str, Any]) -> list[str]:
    """The flags of `npred identify` as a user would write them."""
    inputs = getattr(plants, log["plant"]).inputs
    result = ["--plant", f"{HERE / 'plants.py'}:{log['plant']}"]
    for name, column in log.get("columns", {}).items():
        result += ["--input" if name in inputs else "--state", f"{name}={column}"]
    for key in ("time", "time_unit", "period", "hold", "longest"):
        result += [f"--{key.replace('_', '-')}", f"{log[key]}"] if key in log else []
    result += ["--offset"] if log.get("offset") else []
    for name in log["free"]:
        result += ["--free", name]
    for name, (low, high) in log.get("bounds", {}).items():
        result += ["--bounds", f"{name}={low}:{high}"]
    return result


def command(words: list[str], folder: Path) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of npred in a folder; 124 where it takes too long."""
    environment = {"PYTHONPATH": str(HERE.parents[1])} | os.environ
    environment |= {"OMP_NUM_THREADS": "1", "NPRED_STORE": str(folder / "store")}
    try:
        named = {"cwd": folder, "env": environment, "capture_output": True, "text": True, "timeout": LIMIT}
        done = subprocess.run([sys.executable, "-m", "npred", *words], **named)
    except subprocess.TimeoutExpired:
        return 124, "", f"more than {LIMIT} s"
    return done.returncode, done.stdout, done.stderr


def verdict(log: dict[str, Any], answer: dict[str, Any] | None) -> str:
    """The answer beside the referee's: each input's delay counts, and the worst of them is said."""
    if answer is None:
        return "failed"
    m = len(answer["D"])
    lows, highs = (v if isinstance(v, list) else [v] * m for v in (log["low"], log["high"]))
    slack = answer.get("period", 0.0) / 10
    worst = []
    rows = zip(answer["D"], answer["interval"], answer["identifiable"], lows, highs, strict=True)
    for D, (low, high), certain, least, most in rows:
        least, most = least - slack, most + slack
        meets = low <= most and high >= least
        if certain:  # of a delay that no one knows well, a narrow interval is false wherever it lies
            narrow = high - low < (most - least) / 2 and not log["knowable"]
            true = least <= D <= most and not narrow
            worst.append((0, "right") if true else (4, "FALSE AND CERTAIN"))
        elif not meets:
            worst.append((3, "false, but uncertain"))
        else:
            worst.append((2, "over-cautious") if log["knowable"] and not log.get("below") else (1, "honest"))
    return max(worst)[1]


def row(name: str, data: Path, fast: bool) -> tuple[str, str]:
    """A line of the table, and the sentences below it."""
    log = LOGS[name]
    paths = [log["path"]] if isinstance(log["path"], str) else log["path"]
    files = [str((data / log["repository"].replace("/", "+") / path).resolve()) for path in paths]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        words = ["identify", *files, *flags(log), "--json", "-o", "answer.toml"]
        begin = time.perf_counter()
        code, out, err = command(words, folder)
        seconds = time.perf_counter() - begin
        answer = json.loads(out) if out.lstrip().startswith("{") else None
        answer = answer if answer and "D" in answer else None
        wrote, after = ("yes" if (folder / "answer.toml").exists() else "no"), "–"
        if log["controller"] and not fast:
            if wrote == "no" and answer is not None:
                command([*words, "--accept"], folder)
                wrote = "by --accept" if (folder / "answer.toml").exists() else "no"
            codes = {step: command(words, folder) for step, words in AFTER.items()} if wrote != "no" else {}
            bad = [step for step, (code, _, _) in codes.items() if code]
            after = ("no: " + ", ".join(bad) if bad else "yes") if codes else "no pipeline"
            err += "".join(f"\n{step}: {(codes[step][2] or codes[step][1])[-300:]}" for step in bad)
    said = answer["sentences"] if answer else [line for line in err.splitlines() if line.strip()][-3:]
    spans = "not read" if answer is None else "; ".join(
        f"{D:.4g} [{low:.4g}, {high:.4g}]{'' if certain else ' not certain'}"
        for D, (low, high), certain in zip(answer["D"], answer["interval"], answer["identifiable"], strict=True)
    )  # fmt: skip
    ends = f"{log['low']} to {log['high']}" + ("" if log["knowable"] else ", not knowable")
    star = "*" if log.get("twenty_four") else ""
    read, said_of = "yes" if answer else "no", verdict(log, answer)
    cells = f"{name}{star}", read, spans, ends, said_of, wrote, after, f"{seconds:.1f}"
    below = f"{name} (exit {code}): " + " | ".join(said) + ("\n" + err.strip() if answer and err.strip() else "")
    return "| " + " | ".join(cells) + " |", below


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--fast", action="store_true")
    options = parser.parse_args()
    header = ("log", "read", "D, 95 %", "referee", "verdict", "pipeline", "runs unchanged", "s")
    print("| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    texts, verdicts = [], []
    with ThreadPoolExecutor(options.jobs) as pool:
        for line, below in pool.map(lambda name: row(name, options.data, options.fast), options.names or LOGS):
            print(line, flush=True)
            texts.append(below)
            verdicts.append(line.split(" | ")[4])
    print("\n" + ", ".join(f"{verdicts.count(v)} {v}" for v in sorted(set(verdicts))) + "\n")
    print("\n\n".join(texts))

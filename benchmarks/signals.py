"""Signals at random times over the life of real commands: each ends with the right code and one line, and in time.

    python benchmarks/signals.py [--count 5000] [--seconds 3600] [--seed 0] [--together 4] [--cold 0.2] [--busy 0]

Each command is sent SIGINT, SIGTERM or SIGHUP, half of them to its processes too, as a terminal does, at a time drawn
uniformly over its life, from when npred listens: before, its first imports take a few milliseconds, in which a signal
does what it does by default. A share `cold` of the commands is started afresh; the others are forked from a process
that has loaded the libraries, or thousands would take hours. `busy` loops run beside them. A row per command goes to
stdout: how many were sent, how many ended in spite of it, and how many were wrong; each wrong one is told on stderr.
"""

import argparse
import os
import random
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

LIMIT = 10.0  # s that a command may live after its signal
LINE = "error: interrupted; finished stages and checkpoints are kept: the same command goes on from there\n"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SETS = "--set train.deeponet.epochs=200 --set train.deeponet.checkpoint_every=50"
COMMANDS = {
    "help": "--help",
    "status": "status smoke",
    "generate": "generate smoke -q --force --jobs 1 --set generate.rollouts=200",
    "processes": "generate smoke -q --force --jobs 2 --set generate.rollouts=64",
    "train": f"train smoke -q --force --model deeponet {SETS}",
    "evaluate": "evaluate smoke -q --force --jobs 2",
    "run": f"run smoke -q --jobs 2 {SETS}",
}
LIBRARIES = (
    "torch, h5py, scipy, matplotlib.figure, npred.cli.execute, npred.cli.inspect, npred.lab.stages.train.train, "
    "npred.lab.stages.generate, npred.lab.stages.evaluate.evaluate, npred.lab.stages.bench.bench, "
    "npred.lab.stages.report.report"
)
# The program: says on descriptor READY that it listens, then is `npred`. With WARM it forks one for each line on stdin.
PROGRAM = f"""
import os, signal, sys
def command(ready, arguments):
    from npred.lab.report.terminal import interruption
    interruption.listen()
    os.write(ready, b"!")
    sys.argv = ["npred", *arguments]
    from npred.__main__ import main
    main()
def forked(words):
    ready, out, err, *arguments = words
    if pid := os.fork():
        return pid
    os.setsid()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL if number != signal.SIGINT else signal.default_int_handler)
    for path, number in ((os.devnull, 0), (out, 1), (err, 2)):
        os.dup2(os.open(path, os.O_RDWR | os.O_CREAT), number)
    return command(os.open(ready, os.O_WRONLY), arguments)
if sys.argv[1] != "warm":
    command(int(sys.argv[1]), sys.argv[2:])
else:
    import {LIBRARIES}
    print("warm", flush=True)
    while line := sys.stdin.readline():
        pid = forked(line.split())
        if pid is None:
            break
        print(pid, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended: its code, stderr, seconds of life, and whether it outlived its signal by LIMIT."""

    code: int
    error: str
    seconds: float
    late: bool
    alive: bool  # when its signal came


class Program:
    """Starts commands one after the other: afresh, or forked from a process that has loaded the libraries."""

    def __init__(self, home: Path, number: int) -> None:
        self.folder = home / str(number)
        self.folder.mkdir()
        self.environment = os.environ | {"NPRED_STORE": str(self.folder / "store"), "OMP_NUM_THREADS": "1"}
        self.zygote: subprocess.Popen[str] | None = None
        self.answers: list[str] = []

    def run(self, arguments: list[str], cold: bool, number: int, delay: float, group: bool) -> Ended:
        """The end of a command that gets the signal `number` after `delay` seconds; none for number 0."""
        return (self._cold if cold else self._warm)(arguments, number, delay, group)

    def _cold(self, arguments: list[str], number: int, delay: float, group: bool) -> Ended:
        ready, theirs = os.pipe()
        with (self.folder / "err").open("w+") as error:
            process = subprocess.Popen(
                ["env", "--default-signal=INT,TERM,HUP", sys.executable, "-c", PROGRAM, str(theirs), *arguments],
                cwd=self.folder, env=self.environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=error, pass_fds=(theirs,), start_new_session=True,
            )  # fmt: skip
            os.close(theirs)
            os.read(ready, 1)
            os.close(ready)
            start = time.monotonic()
            alive, late = self._signal(process.pid, number, delay, group), False
            try:
                process.wait(LIMIT if number else None)
            except subprocess.TimeoutExpired:
                late = True
                os.killpg(process.pid, signal.SIGKILL)
            return Ended(process.wait(), self._text(error), time.monotonic() - start, late, alive)

    def _warm(self, arguments: list[str], number: int, delay: float, group: bool) -> Ended:
        if self.zygote is None:
            self.zygote = subprocess.Popen(
                ["env", "--default-signal=INT,TERM,HUP", sys.executable, "-c", PROGRAM, "warm"], cwd=self.folder,
                env=self.environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            )  # fmt: skip
            assert self._answer() == "warm"
        ready, error = self.folder / "ready", self.folder / "err"
        if not ready.exists():
            os.mkfifo(ready)
        error.write_text("")
        assert self.zygote.stdin
        self.zygote.stdin.write(" ".join([str(ready), os.devnull, str(error), *arguments]) + "\n")
        self.zygote.stdin.flush()
        with ready.open("rb", buffering=0) as begun:
            pid = int(self._answer())
            begun.read(1)
        start = time.monotonic()
        alive = self._signal(pid, number, delay, group)
        sent = time.monotonic()
        code = int(self._answer(pid if number else 0))
        ended = time.monotonic()
        with error.open() as text:
            return Ended(code, self._text(text), ended - start, ended - sent > LIMIT and bool(number), alive)

    def _answer(self, pid: int = 0) -> str:
        """The next line of the process that forks; a command `pid` that lives for too long is killed."""
        assert self.zygote and self.zygote.stdout
        while not self.answers:
            if select.select([self.zygote.stdout], [], [], LIMIT)[0]:
                self.answers += os.read(self.zygote.stdout.fileno(), 1000).decode().split()
            elif pid:
                os.killpg(pid, signal.SIGKILL)
        return self.answers.pop(0)

    def _signal(self, pid: int, number: int, delay: float, group: bool) -> bool:
        """Send it; False where there is nobody left."""
        if not number:
            return True
        time.sleep(delay)
        try:
            (os.killpg if group else os.kill)(pid, number)
            return True
        except ProcessLookupError:
            return False

    def _text(self, file) -> str:
        file.seek(0)
        return file.read()


def fault(done: Ended, number: int) -> str:
    """What is wrong with an end, or nothing."""
    if done.late:
        return f"alive after {LIMIT:g} s, then code {done.code}"
    if done.code == 0 and not done.error:  # it had ended
        return ""
    if done.code != 128 + number:
        return f"code {done.code}"
    return "" if done.error == LINE else "not the one line"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seconds", type=float, default=3600.0, help="no signal is sent after so many")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--together", type=int, default=4, help="commands side by side")
    parser.add_argument("--cold", type=float, default=0.2)
    parser.add_argument("--busy", type=int, default=0, help="loops that do nothing, beside them")
    parser.add_argument("--commands", default=",".join(COMMANDS))
    asked = parser.parse_args()
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(asked.busy)]
    names = asked.commands.split(",")
    with tempfile.TemporaryDirectory() as home, ThreadPoolExecutor(asked.together) as pool:
        programs = [Program(Path(home), k) for k in range(asked.together)]
        shares = [range(k, asked.count, asked.together) for k in range(asked.together)]
        try:
            tables = list(pool.map(lambda program, share: campaign(program, share, names, asked), programs, shares))
        finally:
            for loop in [*loops, *(program.zygote for program in programs if program.zygote)]:
                loop.kill()
    total = sum(tables, Counter())
    print(
        f"seed {asked.seed}, busy loops {asked.busy}\n\n"
        "| command | signals | ended all the same | wrong |\n|---|---|---|---|"
    )
    for name in [*names, "all"]:
        print(f"| {name} | {total[name, 'sent']} | {total[name, 'ended']} | {total[name, 'wrong']} |")
    sys.exit(bool(total["all", "wrong"]))


def campaign(program: Program, share: range, names: list[str], asked: argparse.Namespace) -> Counter:
    """The counts of a share of the signals, one after the other."""
    lives, table, begun = {}, Counter(), time.monotonic()
    for turn in share:
        if time.monotonic() - begun > asked.seconds:
            break
        draw = random.Random(f"{asked.seed} {turn}")
        name, number, group = names[turn // asked.together % len(names)], draw.choice(SIGNALS), draw.random() < 0.5
        cold = draw.random() < asked.cold
        arguments = COMMANDS[name].split()
        if (name, cold) not in lives:  # twice: the first compiles
            lives[name, cold] = [program.run(arguments, cold, 0, 0.0, False) for _ in range(2)][1].seconds
        delay = draw.uniform(0, lives[name, cold])
        done = program.run(arguments, cold, number, delay, group)
        wrong = fault(done, number) if done.alive else ""
        for row in (name, "all"):
            table[row, "sent"] += 1
            table[row, "ended"] += done.code == 0
            table[row, "wrong"] += bool(wrong)
        if wrong:
            print(
                f"turn {turn}: {name}, {'cold' if cold else 'warm'}, {signal.Signals(number).name} "
                f"{'to the group ' if group else ''}after {delay:.3f} s: {wrong}\n{done.error}",
                file=sys.stderr,
                flush=True,
            )
    return table


if __name__ == "__main__":
    main()

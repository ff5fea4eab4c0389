"""Mutations of an exported controller that its self-test lets pass, though they change U.

Each line of npred.c that computes is changed: constants, signs, factors, comparisons, conditions, indices, the numbers
of tables and settings; statements are left out. All changes are compiled at once; one at a time is switched on. What
passes the self-test then takes runs of its own, of other seeds; a change matters if U differs there in double precision
by 1e-6 of its size, or a call is refused in place of a command.
"""

import re
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from plants import declared

import npred
from npred.exports import c_controller, self_test
from npred.kernels.c_text import constant
from npred.loop.controller import Controller

ON = "(npred_mutant == {k})"
NUMBER = r"(?:\d+\.\d*(?:e[+-]?\d+)?f?|\d+e[+-]?\d+f?)"
RULES: list[tuple[str, str]] = [  # pattern in a line of a function, and what takes its place
    (rf"(?<![\w.]){NUMBER}(?![\w.])", "((__typeof__({0}))({on} ? 1.1 * {0} + 0.01 : {0}))"),
    (r"(?<![\w.])\d+(?![\w.])", "({0} + {on})"),
    (r"(?<=[\w\])]) [+-](?=\s)", "{0} (1 - 2 * {on}) *"),
    (r"(?<=[\w\])]) \*(?=\s)", "{0} (1 + {on}) *"),
    (r"(?<=[\w\])]) /(?=\s)", " * (1 + {on}) /"),
    (r" [+-]=(?=\s)", "{0} (1 - 2 * {on}) *"),
    (r" (?:<|>|<=|>=)(?=\s)", "{0} {on} +"),
    (r" \?(?=\s)", " != 0 ^ {on} ?"),
    (r" (?:&&|\|\|)(?=\s)", "{0} {on} ^"),
    (r"\b(?:larger|smaller)(?=\()", "({on} ? larger == {0} ? smaller : larger : {0})"),
    (r"(?<=\[)\w+(?=\])", "{0} + {on}"),
]
STATEMENT = re.compile(r"^(\s*)((?!\w+ \*?\w)(?!for \(|if \()[\w*(].*(?: =|\+=|-=|\*=|/=|\w\().*;)$")  # no declaration
CONDITION = re.compile(r"^(\s*(?:\} else )?if \()(.*)(\) \{)$")
WEIGHTS = 40  # of a table of a network's numbers: so many are changed
DRIVER = r"""
#define _POSIX_C_SOURCE 200809L
static int npred_mutant = -1;
#define NPRED_TEST
#define main self_test
#include "npred.c"
#undef main
#include "runs.h"
#include "changes.h"
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

static double before[RUN_CALLS][NPRED_M_INPUTS], size[NPRED_M_INPUTS];
static npred_controller c;

/* Whether the self-test passes. */
static int passes(int unused)
{
    (void)unused;
    return freopen("/dev/null", "w", stdout) && self_test() == 0;
}

/* How many decades below its size U of the runs changes at most, up to SAME. */
static int same(int first)
{
    double most = 0;
    for (int s = 0; s < RUN_CALLS; s++) {
        npred_real U[NPRED_M_INPUTS];
        if (s % RUN_LENGTH == 0) {
            npred_init(&c);
        }
        const int code = run_call(&c, s, U);
        for (int i = 0; i < NPRED_M_INPUTS; i++) {
            const double now = code == NPRED_OK ? (double)U[i] : NAN;
            if (first) {
                before[s][i] = now;
                size[i] = fmax(size[i], fabs(now));
            } else if (isnan(now) != isnan(before[s][i])) {
                return 0;
            } else if (!isnan(now)) {
                most = fmax(most, fabs(now - before[s][i]) / size[i]);
            }
        }
    }
    return most < pow(10, -SAME) ? SAME : (int)fmax(-log10(most), 0);
}

static int forked(int k, int (*what)(int))
{
    int status;
    fflush(stdout);
    const pid_t child = fork();
    if (child == 0) {
        npred_mutant = k;
        change_tables(k);
        const struct rlimit limit = {LIMIT_S, LIMIT_S}; /* of processor time: a busy machine is no difference */
        setrlimit(RLIMIT_CPU, &limit);
        _exit(what(0));
    }
    waitpid(child, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 0; /* a crash is seen */
}

int main(int count, char **chosen)
{
    int (*const what)(int) = atoi(chosen[1]) ? same : passes;
    same(1);
    printf("%d\n", forked(-1, what)); /* apart, as the others: what is static stays as it was */
    for (int a = 2; a < count; a++) {
        printf("%d\n", forked(atoi(chosen[a]), what));
    }
    return 0;
}
"""
SAME = 6  # decades below its size: U that changes by less is the same
RUN_CALL = "static int run_call(npred_controller *c, int s, npred_real *U)"


class Mutant(NamedTuple):
    """One change: the line of npred.c, from 0, and what is written there."""

    line: int
    text: str
    change: float = 0.0  #: of U, of its size


class Row(NamedTuple):
    """What became of a controller's mutants; `matter` are those that pass and change U."""

    mutants: int
    passed: int
    matter: list[Mutant]


def mutated(source: str) -> tuple[list[str], list[Mutant], list[str]]:
    """The lines with all mutants, which `npred_mutant` chooses, the mutants, and statements that change tables."""
    end = source.index("#ifdef NPRED_TEST")
    lines, rest = without_comments(source[:end]).split("\n"), source[end:]
    mutants: list[Mutant] = []
    tables: list[str] = []
    body = False
    for number, line in enumerate(lines):
        body = body and line != "}"
        if table := re.match(r"static const (?:double|float|npred_real) (\w+)\[(\d+)\] = \{$", line):
            count = int(table[2])
            for element in np.unique(np.linspace(0, count - 1, min(count, WEIGHTS)).astype(int)):
                place = f"{table[1]}[{element}]"
                tables.append(f"case {len(mutants)}: {place} = {place} * 1.01f + 0.01f * ({place} == 0); break;")
                mutants.append(Mutant(number, place))
            lines[number] = line.replace("static const", "static")
        elif line == "static const Settings the_settings = {":
            lines[number] = line.replace("const ", "")
        elif setting := re.match(r"    \.(\w+) = ([\d.e+-]+)f?,$", line):
            value = "!the_settings.{0}" if "." not in setting[2] else "the_settings.{0} * 1.01f + 0.001f"
            changed = value.format(setting[1])
            tables.append(f"case {len(mutants)}: the_settings.{setting[1]} = {changed}; break;")
            mutants.append(Mutant(number, changed))
        elif define := re.match(rf"(#define \w+ )({NUMBER})$", line):
            lines[number] = define[1] + replaced(define[2], RULES[:1], number, mutants)
        elif body and not line.startswith("#") and not re.match(r"\s*static const", line):
            lines[number] = of_a_line(line, number, mutants)
        body = body or line == "{"
    return [*lines, rest], mutants, tables


def of_a_line(line: str, number: int, mutants: list[Mutant]) -> str:
    """A line of a function with its mutants."""
    condition, statement = CONDITION.match(line), STATEMENT.match(line)
    now = replaced(line, RULES, number, mutants)
    if condition:
        head, last = len(condition[1]), len(condition[3])
        now = f"{now[:head]}!!({now[head:-last]}) ^ {ON.format(k=len(mutants))}{condition[3]}"
        mutants.append(Mutant(number, f"if (!({condition[2]}))"))
    if statement:
        now = f"if (!{ON.format(k=len(mutants))}) {{ {now.strip()} }}"
        mutants.append(Mutant(number, f"no {statement[2]}"))
    return now


def replaced(line: str, rules: list[tuple[str, str]], number: int, mutants: list[Mutant]) -> str:
    """The line with a mutant at each place of a rule."""
    places = sorted(
        ((found.start(), found.end(), text) for pattern, text in rules for found in re.finditer(pattern, line)),
        key=lambda place: place[:2],
    )
    now, done = "", 0
    for start, end, text in places:
        if start < done:
            continue
        found, on = line[start:end], ON.format(k=len(mutants))
        mutants.append(Mutant(number, f"{line[:start].strip()} >>{found.strip()}<<{line[end:]}"))
        now, done = now + line[done:start] + text.format(found, on=on), end
    return now + line[done:]


def without_comments(text: str) -> str:
    return re.sub(r"/\*.*?\*/", lambda comment: "\n" * comment[0].count("\n"), text, flags=re.DOTALL)


def runs(controller: Controller, seed: int, count: int = 6, length: int = 150) -> str:
    """The C of calls without the rules of the self-test, and of what is measured in them."""
    tests = [drawn(controller, np.random.default_rng([seed, run]), length) for run in range(count)]
    joined = self_test.Test(*map(np.concatenate, zip(*tests, strict=True)))
    arrays = {"X": joined.X, "u": joined.u} if joined.u.size else {"X": joined.X}
    real = "npred_real"
    vectors = [re.sub(r"const double|const float", f"const {real}", constant(f"run_{name}", np.ravel(a)))
               for name, a in arrays.items()]  # fmt: skip
    vectors += [constant(f"run_{name}", a) for name, a in (("t", joined.t), ("taken", joined.taken))]
    does = f"static const unsigned char run_does[] = {{{', '.join(map(str, joined.does))}}};"
    return "\n".join([f"enum {{ RUN_CALLS = {count * length}, RUN_LENGTH = {length} }};", does, *vectors])


def drawn(controller: Controller, random: np.random.Generator, length: int) -> self_test.Test:
    """A run of calls at random."""
    if not controller.settings.reads_commands:
        return measured(controller, random, length)
    world, player, rows = self_test._World(controller, 1.0), self_test._Player(controller, np.zeros(0)), []
    world.random, shift, old = random, 0.0, len(controller.memory.signals.held)
    outputs = controller.observer.measured if controller.observer else np.asarray
    whats = ["now", "plain", "none", "far", "wild", "nan", "kick", "applied", "saved", "estimate", "time"]
    often = np.array([8, 5, 2, 0.5, 0.1, 0.2, 0.4, 0.3, 0.2, 0.1, 0.1])
    for s in range(length):
        what = str(random.choice(whats, p=often / often.sum()))
        gap = 1.0 if what == "plain" or random.random() < 0.5 else float(random.uniform(0.05, 3.0))
        gap = (
            float(random.choice([6.0, 0.3 * old, old, 5.0 * old]))
            if random.random() < 0.03 and what != "plain"
            else gap
        )
        world.to(world.t + gap * controller.dt * (s > 0))
        if what == "kick":
            world.kick()
        shift += float(random.uniform(0.1, 3.0)) * (what == "time")
        age = (
            float(random.uniform(0, 1.2 * controller.memory.oldest + 2))
            if random.random() < 0.25 and what != "plain"
            else 0.0
        )
        X = world.past[max(len(world.past) - 1 - round(age), 0)]
        X = X + world.half * (random.uniform(-2, 2) * (what == "far") + 100 * (what == "wild"))
        Y = np.asarray(outputs(X), dtype=float)
        Y = Y * np.nan if what in ("none", "nan") else Y
        t = world.t + shift
        call = self_test.DOES.get(what, self_test.SAMPLED | self_test.STAMPED), t, t - age * controller.dt, Y
        rows.append(call)
        with np.errstate(all="ignore"):
            world.sent.append((world.t, np.nan_to_num(player.call(s, *call)[0])))
    return self_test.Test(*map(np.array, zip(*rows, strict=True)), np.zeros(0))


def measured(controller: Controller, random: np.random.Generator, length: int) -> self_test.Test:
    """One of a controller that is given u."""
    world, x = self_test._World(controller, 1.0), np.linspace(0, 1, controller.predictor.nx)[:, None]
    world.random, X, u = random, [], []
    for _ in range(length):
        world.kick()
        X.append(world.X)
        a, b = (controller.plant.kappa(world.middle + k * (world.X - world.middle)) for k in random.uniform(0, 1, 2))
        u.append(a + (b - a) * x + random.uniform(0, 0.5) * (b - a) * np.sin(random.uniform(1, 9) * x))
    does = np.where(random.random(length) < 0.5, self_test.SAMPLED, self_test.SAMPLED | self_test.STAMPED)
    t = controller.t + np.arange(length) * controller.dt
    return self_test.Test(does, t, t, np.array(X), np.array(u))


def run_call(source: str) -> str:
    """The C function that makes a call of these runs: that of the self-test with other names."""
    (body,) = re.findall(r"static int test_call\(.*?^\}$", source, re.MULTILINE | re.DOTALL)
    names = {"test_": "run_", "TEST_ROWS": "RUN_CALLS", "TEST_U_ROWS": "RUN_CALLS", "run_set(": "test_set("}
    for old, new in names.items():
        body = body.replace(old, new)
    return body


def judged(controller: Controller, precision: str = "double", count: int = 1500, seed: int = 0, part: str = "") -> Row:
    """What becomes of `count` mutants of a controller's export, drawn without replacement, of one of its parts or of
    all. Whether U changes is asked in double precision.
    """
    with tempfile.TemporaryDirectory() as name:
        folders = {real: Path(name, real) for real in {precision: 0, "double": 0}}
        built = [written(folder, controller, real, seed) for real, folder in folders.items()]
        mutants, lines, dropped = built[0][0], range(len(built[0][1])), {line for *_, lines in built for line in lines}
        assert len(built[-1][0]) == len(mutants)
        if part:
            text = without_comments(controller.parts[part].text).split("\n")
            first = built[-1][1].split("\n").index(text[0])
            lines = range(first, first + len(text))
        left = [k for k, mutant in enumerate(mutants) if mutant.line not in dropped and mutant.line in lines]
        chosen = np.sort(np.random.default_rng(seed).permutation(left)[:count])

        def ran(folder: Path, what: str, of: np.ndarray) -> list[int]:
            command = ["./driver", what, *map(str, of)]
            first, *rest = map(int, subprocess.run(command, cwd=folder, stdout=-1, check=True).stdout.split())
            assert first == (SAME if what == "1" else 1), (
                "the text without a change must pass, and give the same U twice"
            )
            return rest

        passed = chosen[np.array(ran(folders[precision], "0", chosen)) == 1]
        changes = ran(folders["double"], "1", passed)
    matter = [
        mutants[k]._replace(change=10.0**-least) for k, least in zip(passed, changes, strict=True) if least < SAME
    ]
    return Row(len(chosen), len(passed), matter)


def written(folder: Path, controller: Controller, real: str, seed: int) -> tuple[list[Mutant], str, set[int]]:
    """Build the driver; the mutants, the text, and the lines whose mutants are no C."""
    folder.mkdir()
    header, source = c_controller.sources(controller, precision=real)
    (folder / "npred.h").write_text(header)
    (folder / "runs.h").write_text(f"#define npred_real {real}\n" + runs(controller, seed) + "\n" + run_call(source))
    (folder / "driver.c").write_text(f"#define npred_real {real}\n#define SAME {SAME}\n#define LIMIT_S 5\n{DRIVER}")
    lines, mutants, tables = mutated(source)
    return mutants, without_comments(source), compiled(folder, source, lines, mutants, tables)


def compiled(folder: Path, source: str, lines: list[str], mutants: list[Mutant], tables: list[str]) -> set[int]:
    """Compile all mutants; the lines whose mutants are no C, which stand as they were."""
    original, dropped = without_comments(source[: source.index("#ifdef NPRED_TEST")]).split("\n"), set[int]()
    while True:
        kept = [original[i] if i in dropped else line for i, line in enumerate(lines[:-1])]
        (folder / "npred.c").write_text("\n".join([*kept, lines[-1]]))
        cases = "\n".join(tables)
        (folder / "changes.h").write_text(
            f"static void change_tables(int k)\n{{\n    switch (k) {{\n{cases}\n    }}\n}}\n"
        )
        flags = ["-std=gnu99", "-O1", "-w", "-fmax-errors=0", "-ffp-contract=off"]
        command = ["gcc", *flags, "driver.c", "-o", "driver", "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        if done.returncode == 0:
            return dropped
        wrong = {int(line) - 1 for line in re.findall(r"npred\.c:(\d+):", done.stderr)} - dropped
        if not wrong:
            raise SystemExit(done.stderr[:2000])
        dropped |= wrong


Rail = declared(  # an angle and its speed, which has limits
    "Rail", "angle speed", "i", lambda x, u, t, p, M: [x.speed, M.sin(x.angle) - 0.5 * x.speed + u.i],
    [(-3.0, 3.0), (-1.0, 1.0)], (-20.0, 20.0), kappa=lambda x, t, p, M: [-M.sin(x.angle) - 2 * x.angle - 2 * x.speed],
    V=lambda x, t, p, M: x.angle**2 + x.speed**2, safe=lambda x, t, p, M: [0.3 - x.speed, 0.3 + x.speed],
)  # fmt: skip


def controllers() -> dict[str, tuple[Callable[[], Controller], str]]:
    """The twelve, and their precisions."""

    def history(name: str | type, law=None, D_hat=0.3, nx=31, method="heun", **more) -> Controller:
        plant = npred.plants.Plant("rail", Rail) if name is Rail else npred.plant(name)
        D = None if plant.declares_delay else D_hat
        return npred.controller(
            plant, npred.predictor(plant, method, nx), law, 0.01, D_hat=D, actuator="history", **more
        )

    paper, chemostat = map(npred.plant, ("activator_repressor", "chemostat"))
    heun, euler = npred.predictor(paper, "heun", 21), npred.predictor(paper, "euler", 21)
    adapting = npred.DelayAdaptation(1000.0, bounds=(0.1, 4.0))
    observed = {"law": npred.DelayObserver(bounds=(0.1, 1.0), candidates=20), "D_hat": 0.5}
    offset = {"outputs": ("S",), "offset": True}
    return {
        "plain": (lambda: history("scalar"), "double"),
        "rk4": (lambda: history("cart_pole", method="rk4"), "double"),
        "float": (lambda: history("van_der_pol", method="rk4"), "float"),
        "law": (lambda: npred.controller(paper, heun, adapting, 0.01, D_hat=2.0, actuator="measured"), "double"),
        "L1": (lambda: history("activator_repressor", npred.L1Adaptation(0.01, bounds=(0.1, 0.5)), 0.2), "double"),
        "observer of the delay": (lambda: history("van_der_pol", **observed), "double"),
        "guard": (lambda: npred.controller(
            paper, npred.guarded(euler, 1e-5), None, 0.01, D_hat=0.2, actuator="history"), "double"),
        "two inputs, watchdog": (lambda: history(
            "unicycle", D_hat=0.2, watchdog=npred.Watchdog(0.065, [0.2, -0.1], jump=[0.03, np.inf])), "double"),
        "declared": (lambda: history("unicycle_time_delay"), "double"),
        "EKF": (lambda: history(
            "chemostat", observer=npred.observers.EKF(chemostat, **offset), watchdog=npred.Watchdog(0.3)), "double"),
        "Luenberger": (lambda: history(
            "chemostat", observer=npred.observers.Luenberger(chemostat, **offset)), "double"),
        "filter": (lambda: history(Rail, safety=npred.SafetyFilter(3.0, delay=0.02)), "double"),
    }  # fmt: skip


TWELVE = controllers()

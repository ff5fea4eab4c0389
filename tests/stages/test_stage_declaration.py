"""A stage is a folder of two files, and a name."""

import json
import subprocess
import sys
from pathlib import Path

from conftest import process_environment

FILES = {
    "__init__.py": '''
"""How many rows there are."""

from npred.lab.scheduler.declaration import Stage

STAGE = Stage(
    __name__, 1, ("generate",), "npred.lab.stages.probe.probe:Probed", table_class="npred.lab.stages.probe.probe:Probe"
)


def key(slices):
    return {"probe": slices.config.optional("probe").model_dump(mode="json")}
''',
    "probe.py": '''
from npred.lab.config.section import Count, Section
from npred.lab.config.results import Generated, Result


class Probe(Section):
    """What is asked."""

    times: Count = 1  #: how often rows count


class Probed(Result):
    """What was found."""

    rows: int  #: how many


def run(job):
    return Probed(rows=Generated.read(job.inputs["generate"]).samples * job.config.optional("probe").times)


def summary(result, width=None):
    return f"{result.rows} rows"
''',
}
PROGRAM = """
import npred.lab.stages
from npred.base import registry

npred.lab.stages.__path__.append("{folder}")
registry.STAGES = (*registry.STAGES, "probe")
from npred.cli import main

main()
"""


def test_a_new_stage_is_a_folder_and_a_name(tmp_path: Path, pipeline: Path):
    """Command, key, table with its checks, result and summary follow."""
    folder = tmp_path / "stages" / "probe"
    folder.mkdir(parents=True)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (tmp_path / "program.py").write_text(PROGRAM.format(folder=folder.parent))

    def call(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "program.py", *arguments]
        return subprocess.run(command, cwd=tmp_path, env=process_environment(), capture_output=True, text=True)

    assert "How many rows there are." in call("--help").stdout
    asked = ["probe", str(pipeline), "--set", "probe.times=2", "--set", "generate.t_end=2"]
    done = call(*asked)
    assert done.returncode == 0 and "1000 rows" in done.stdout, done.stderr
    again = json.loads(call(*asked, "--json").stdout)["stages"][-1]
    assert (again["stage"], again["action"]) == ("probe", "hit")
    assert "probe.times: 2 -> 3" in call("why", "probe", str(pipeline), *asked[4:], "--set", "probe.times=3").stdout
    wrong = call("probe", str(pipeline), "--set", "probe.tims=2")
    assert wrong.returncode == 2 and "probe.tims: unknown key; expected one of times" in wrong.stderr

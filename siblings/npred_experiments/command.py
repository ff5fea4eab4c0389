"""The command `npred reproduce`, as the command line declares it: its work is imported when it is called."""

from pathlib import Path
from typing import Annotated

from npred.cli.options import Common, argument, flag


def reproduce(
    options: Common,
    *,
    names: Annotated[list[str] | None, argument("NAME", "Experiments; by default all.")] = None,
    listed: Annotated[bool, flag("Print the experiments, and run nothing.", "--list")] = False,
    numerical: Annotated[bool, flag("Only the rows with numerical predictors.", "--numerical")] = False,
    force: Annotated[bool, flag("Measure again even if the store has the result.", "--force")] = False,
    output: Annotated[
        Path | None, flag("Write a page: HTML, or Markdown if the name ends in .md.", "-o", "--output", word="FILE")
    ] = None,
) -> None:
    """Repeat published experiments: each printed number beside the same loop run here, as published and as meant."""
    from npred_experiments.reproduce import reproduce

    reproduce(options, names, listed, numerical, force, output)

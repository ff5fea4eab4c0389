"""The command `npred reproduce`, as the command line declares it: its work is imported when it is called."""

from pathlib import Path
from typing import Annotated

from npred.cli.options import Common, argument, flag


def reproduce(
    options: Common,
    *,
    names: Annotated[list[str] | None, argument("NAME", "Experiments; all by default.")] = None,
    listed: Annotated[bool, flag("Print the experiments, and run nothing.", "--list")] = False,
    numerical: Annotated[bool, flag("The rows of numerical predictors only.", "--numerical")] = False,
    force: Annotated[bool, flag("Measure again what the store has.", "--force")] = False,
    output: Annotated[
        Path | None, flag("The page: HTML, or Markdown for a name that ends in .md.", "-o", "--output", word="FILE")
    ] = None,
) -> None:
    """Published experiments: each printed number beside the same loop run here, as published and as it is meant."""
    from npred_experiments.reproduce import reproduce

    reproduce(options, names, listed, numerical, force, output)

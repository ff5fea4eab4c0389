"""The result of the stage generate."""

from npred.results.base import Result


class Generated(Result):
    """The data: their size, and what of them no network sees."""

    samples: int  #: rows of data
    rollouts: int  #: closed loops that they are taken from
    held_out: list[int]  #: numbers of the rollouts held out
    nx: int  #: nodes on [0, 1]
    shards: int = 0  #: how many files hold the rows, where there are several; else absent

"""The results of the stages generate, train and report."""

from npred.results.base import Number, Result


class Generated(Result):
    """The data: their size, and what of them no network sees."""

    samples: int  #: rows of data
    rollouts: int  #: closed loops that they are taken from
    held_out: list[int]  #: numbers of the rollouts held out
    nx: int  #: nodes on [0, 1]
    shards: int = 0  #: how many files hold the rows, where there are several; else absent


class Trained(Result):
    """A trained network; the errors are those of the last epoch, on held-out rollouts."""

    model: str  #: the network's name
    parameters: int  #: how many numbers were trained
    samples: int  #: rows that it was trained on
    epochs: int  #: how often it saw them
    loss: Number  #: the last epoch's
    mse: Number  #: mean square error
    eps_sup: Number  #: largest |P̂ − P|


class Reported(Result):
    """The page."""

    summary: list[str]  #: three sentences: the error, the closed loop, the time of a call
    bytes: int  #: of the page

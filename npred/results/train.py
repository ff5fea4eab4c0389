"""The result of the stage train, of one network."""

from npred.results.base import Number, Result


class Trained(Result):
    """A trained network; the errors are those of the last epoch, on held-out rollouts."""

    model: str  #: the network's name
    parameters: int  #: how many numbers were trained
    samples: int  #: rows that it was trained on
    epochs: int  #: how often it saw them
    loss: Number  #: the last epoch's
    mse: Number  #: mean square error
    eps_sup: Number  #: largest |P̂ − P|

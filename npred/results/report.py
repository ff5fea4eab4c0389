"""The result of the stage report."""

from npred.results.base import Result


class Reported(Result):
    """The page."""

    summary: list[str]  #: three sentences: the error, the closed loop, the time of a call
    bytes: int  #: of the page

"""Published predictor-feedback experiments, run again: as published, and as their articles mean them.

One file for each, which an entry point of the group `npred.experiments` names, and the files that they share.
"""

from npred.base.registry import Registry

EXPERIMENTS = Registry("experiment", "npred.experiments")

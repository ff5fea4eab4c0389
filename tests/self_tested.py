"""The controllers of benchmarks/self_test_mutants.py, and the mutations of their exports."""

import importlib.util

from conftest import HERE

SPEC = importlib.util.spec_from_file_location("self_test_mutants", HERE.parent / "benchmarks" / "self_test_mutants.py")
assert SPEC is not None and SPEC.loader is not None
mutants = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(mutants)
TWELVE = mutants.controllers()

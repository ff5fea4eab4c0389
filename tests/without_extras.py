"""npred in a process that lacks the packages of its extras; also a program that is `npred` there.

Their imports fail as those of packages that are not installed.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from typing import Any

PACKAGES = {
    "torch", "pandas", "onnx", "onnxruntime", "onnxscript", "scipy", "sympy", "distributed", "control",
    "mcap", "mcap_ros2", "rosbags", "pyulog", "pyarrow", "python_calamine",
}  # fmt: skip


class Absent(MetaPathFinder):
    """Finds none of them."""

    def find_spec(self, fullname: str, path: Sequence[str] | None = None, target: Any = None) -> ModuleSpec | None:
        if fullname.partition(".")[0] in PACKAGES:
            raise ModuleNotFoundError(f"No module named {fullname!r}", name=fullname)
        return None


sys.meta_path.insert(0, Absent())

if __name__ == "__main__":
    from npred.__main__ import main

    main()

"""`npred` in a process that lacks what Windows lacks: modules, signals and system calls of POSIX.

Paths, processes and the compiler stay this system's. The lock is one that every system has.
"""

import os
import signal
import sys

MODULES = ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty")
SIGNALS = (
    "SIGALRM", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT", "SIGTSTP", "SIGUSR1", "SIG_BLOCK", "SIG_SETMASK",
    "pthread_sigmask", "setitimer", "sigwait",
)  # fmt: skip
CALLS = (
    "O_DIRECTORY", "fork", "getegid", "geteuid", "getgid", "getuid", "killpg", "mkfifo",
    "sched_getaffinity", "sched_setaffinity", "setsid", "statvfs", "sysconf", "sysconf_names",
)  # fmt: skip


def forget() -> None:
    """Take them away, but for locks and the way to start processes, which are this system's."""
    import multiprocessing.util  # noqa: F401
    import subprocess  # noqa: F401

    import filelock  # noqa: F401

    sys.modules.update(dict.fromkeys(MODULES))
    for module, names in ((signal, SIGNALS), (os, CALLS)):
        for name in names:
            if hasattr(module, name):
                delattr(module, name)


if __name__ == "__main__":
    forget()
    from npred.__main__ import main

    main()

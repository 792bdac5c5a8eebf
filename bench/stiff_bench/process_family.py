"""Processes that end with the one they work for, and what a model's process starts with it."""

from __future__ import annotations

import ctypes
import fcntl
import os
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing import parent_process
from multiprocessing.connection import wait

import psutil

_PR_SET_CHILD_SUBREAPER = 36  # prctl(2)


def end_with_parent() -> None:
    """Lead a group of processes of our own, and have it killed when the parent's process ends.

    On Linux the kernel does it, whatever this process does: it sends a signal to the group when the
    pipe that the parent holds is closed (fcntl(2), F_SETOWN and F_SETSIG). Processes that are
    started below and detach themselves stay our descendants. Elsewhere a thread waits.
    """
    os.setsid()
    parent = parent_process()
    if parent is None:
        return
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, -os.getpgrp())
        fcntl.fcntl(parent.sentinel, fcntl.F_SETSIG, signal.SIGKILL)
        flags = fcntl.fcntl(parent.sentinel, fcntl.F_GETFL)
        fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, flags | os.O_ASYNC)
        if wait([parent.sentinel], 0):  # it was gone before
            os.killpg(0, signal.SIGKILL)
    else:
        threading.Thread(target=_wait_and_end, daemon=True).start()


def _wait_and_end() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os.killpg(0, signal.SIGKILL)


def end_descendants(pid: int) -> None:
    """Kill every process below this one."""
    for process in descendants(pid):
        with suppress(psutil.Error):
            process.kill()


def descendants(pid: int) -> list[psutil.Process]:
    """Return the processes below one, those of other sessions too; none where it is gone."""
    try:
        return list(psutil.Process(pid).children(recursive=True))
    except psutil.Error:
        return []


def end_family(pid: int) -> None:
    """Kill a process that leads a group, with the group and every process below it."""
    below = descendants(pid)  # before they lose their parent
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)
    for process in below:
        with suppress(psutil.Error):
            process.kill()

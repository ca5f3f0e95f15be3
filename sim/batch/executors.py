"""Executors for flights: processes of this machine, or a dask cluster."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from smolbot.errors import InputError

CONNECT_SECONDS = 10.0
"""How long a cluster's scheduler may take to answer."""


@contextmanager
def open_executor(jobs: int = 0, scheduler: str | None = None) -> Iterator[Executor]:
    """Open an executor of processes on this machine, or of a dask cluster.

    Parameters
    ----------
    jobs : int
        Number of processes; 0 takes one per core, 1 a thread of this process.
    scheduler : str, optional
        Address of a dask scheduler, instead of processes.

    Yields
    ------
    concurrent.futures.Executor

    Raises
    ------
    InputError
        If no scheduler answers at that address, or dask is not installed.
    """
    if scheduler is None and jobs == 1:
        with ThreadPoolExecutor(1) as here:
            yield here
        return
    if scheduler is None:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core each; small matrices gain nothing from more
        context = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(jobs or os.cpu_count() or 1, mp_context=context) as pool:
            yield pool
        return
    try:
        distributed: Any = import_module("distributed")
    except ModuleNotFoundError:
        raise InputError("--scheduler needs dask: pip install 'smolbot[cluster]'.") from None
    try:
        client = distributed.Client(scheduler, timeout=CONNECT_SECONDS)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: no dask scheduler answers there ({error}).") from None
    with client:
        yield client.get_executor()

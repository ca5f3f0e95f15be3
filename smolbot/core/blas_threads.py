"""Linear algebra with one thread: results that do not depend on how many cores a machine or a notebook lends.

With several threads, products of matrices of some hundred rows are summed in another order, and a run differs in its
last bits from the same run with one. Small matrices gain nothing from threads either.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread() -> Iterator[None]:
    """While the block runs, numpy's and scipy's linear algebra use one thread."""
    import numpy.linalg  # noqa: F401  (a library that is not loaded yet cannot be limited)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield


def kernel() -> str:
    """Library and kind of processor for which linear algebra is computed: it decides the last bits of a result."""
    import numpy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info

    found = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    return ", ".join(sorted({f"{pool['internal_api']} {pool.get('architecture', '')}".strip() for pool in found}))

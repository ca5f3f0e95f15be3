"""Linear algebra with one thread, so that results do not depend on the number of processor cores.

With several threads, products of matrices of some hundred rows are summed in another order, and a run differs in
its last bits from the same run with one thread. Small matrices gain nothing from threads either.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def limit_to_one_thread() -> Iterator[None]:
    """Limit the linear algebra of numpy and scipy to one thread while the block runs.

    Yields
    ------
    None
    """
    import numpy.linalg  # noqa: F401  (a library that is not loaded yet cannot be limited)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1, user_api="blas"):
        yield


def describe_blas() -> str:
    """Return the name of the linear algebra library and the processor type that its kernels are made for.

    They decide the last bits of a result.

    Returns
    -------
    str
        For instance ``openblas Haswell``; several libraries are separated by commas.
    """
    import numpy.linalg  # noqa: F401
    from threadpoolctl import threadpool_info

    found = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    return ", ".join(sorted({f"{pool['internal_api']} {pool.get('architecture', '')}".strip() for pool in found}))

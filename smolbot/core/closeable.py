"""Base class of objects that are closed at the end of a ``with`` block."""

from __future__ import annotations

from typing import Self


class Closeable:
    """Base class of objects that hold a resource until they are closed or their ``with`` block ends."""

    def close(self) -> None:
        """Release the resource."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

"""Makes expected answers anew and tells why: `python -m tests.golden.renew NAME … --why "…"`; windows stay as they are.

Without names, everything that differs. `--add NAME RUN` packs the record of a run into the corpus under a new name.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tests.golden.answers import GoldenFileError, compare, load, save
from tests.golden.corpus import EXPECTED, pack_record, tell
from tests.golden.flights import MAKERS


def renew(names: list[str], why: str) -> int:
    """Make answers anew, say how far they went, and tell it in ``CHANGES.md``; how many changed."""
    changed = 0
    for name in names:
        path = EXPECTED / f"{name}.json.xz"
        now = MAKERS[name]()
        if path.exists():
            difference = compare(load(path)[1], now)
            if difference is None:
                print(f"{name}: the same, bit for bit; left as it is")
                continue
            sizes = ", ".join(f"{size:.2g} {unit or '(relative)'}" for unit, size in difference.most.items())
        else:
            difference, sizes = None, "new"
        save(path, now)
        tell(name, why, sizes)
        print(f"{name}: {difference or 'new'}")
        changed += 1
    return changed


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.golden.renew", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help=f"of {', '.join(MAKERS)}; all by default")
    parser.add_argument("--why", default="", help="one line for CHANGES.md")
    parser.add_argument("--add", nargs=2, metavar=("NAME", "RUN"), help="pack a run's record into the corpus")
    asked = parser.parse_args()
    strange = [name for name in asked.names if name not in MAKERS]
    if strange:
        parser.error(f"no answers are named {', '.join(strange)}; those are {', '.join(MAKERS)}")
    try:
        if asked.add:
            print(pack_record(asked.add[0], Path(asked.add[1]) / "run.mcap"))
            return
        if not asked.why.strip():
            parser.error('say why: --why "…"; it goes into tests/golden/CHANGES.md')
        print(f"{renew(asked.names or list(MAKERS), asked.why)} changed")
    except GoldenFileError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()

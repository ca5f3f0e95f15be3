"""Reports: a page on how a run went and why, pages that compare runs, and short animations of a run."""

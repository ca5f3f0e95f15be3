"""Reports: one page that says how a run went and why, pages that compare runs, and short animations of one."""

"""Tune two gains on random simulations of the reduced plant, and validate them on held-out ones in the full tank."""

import smolbot

found = smolbot.tune("line", only=["p_thr_mm", "spacing_mm"], trials=5, worlds=2, held_out=1)
print("better" if found.improved else "not better", dict(found.tuned.gains))
print("cost of each trial, in mm:", found.table()["cost_mm"].round(3))

"""Locate again in the recordings of a flight, with the estimator of the paper, and compare the poses."""

import numpy as np

import smolbot

smolbot.run("line", seed=2, out="flown", report=False, force="preview", stop__max_duration_s=10.0)
again = smolbot.replay("flown", estimator="paper").table()
for who in ("recorded", "replayed"):
    errors = np.hypot(again[f"{who}_x"] - again["true_x"], again[f"{who}_y"] - again["true_y"])
    print(f"{who}: {1e3 * np.nanmean(errors):.2f} mm from the truth on average")

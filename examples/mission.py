"""Fly a mission in the simulated tank, and draw where the robot was and where the tracker estimated it to be."""

import matplotlib.pyplot as plt

import smolbot

run = smolbot.run("line", seed=2)
print(run.status, run.summary["tracking_error_mm"])
flown = run.table()
plt.plot(*run.true_trail[:, :2].T, label="true robot")
plt.plot(flown["tracked_x"], flown["tracked_y"], label="as tracked")
plt.legend()
plt.savefig("mission.png")

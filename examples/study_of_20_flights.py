"""Fly a mission in twenty simulated tanks, each a little different, and draw how far the robots were from the path."""

import matplotlib.pyplot as plt

import smolbot

found = smolbot.simulate("line", range(1, 21), plant="reduced")
low, high = found.pass_rate_95
print(f"{found.passed} of {len(found.flights)} passed: {low:.0%} to {high:.0%} would, with 95 % confidence")
plt.hist(found.table()["tracking_rms_mm"])
plt.xlabel("rms distance of the true robot to the path, in mm")
plt.ylabel("flights")
plt.savefig("study.png")

"""Missions timed and flown on paper."""

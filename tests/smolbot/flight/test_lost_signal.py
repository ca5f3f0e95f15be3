"""A signal that is away for some seconds ends no flight; one that stays away ends it with its reason."""

from __future__ import annotations

import json

import pytest

from smolbot.config.mission import load_steering_mission
from smolbot.core.shots import Actuate
from smolbot.flight.session import fly
from smolbot.runs.run import Run

SHORT = {
    "path.points_mm": "[[-1.5, 0.0], [1.5, 0.0]]", "start.offset_mm": "[-0.5, 0.3]", "localization.quiet_s": "2.0",
    "localization.estimator": "paper",
}  # fmt: skip


def fly_with(fault: str, **settings: str) -> Run:
    return fly(load_steering_mission("line", settings={**SHORT, "rig.tank.faults": json.dumps([fault]), **settings}), 3)


@pytest.mark.parametrize(
    ("fault", "mode", "reason"),
    [
        ("windows_lost@3.5s:2", "hold", "its recording was lost"),
        ("excitation_lost@3.5s:2", "lost", "the device was not heard"),
    ],
)
def test_a_loss_of_two_seconds_is_waited_for_and_told(fault: str, mode: str, reason: str) -> None:
    run = fly_with(fault)
    assert run.status == "completed"
    lost, back = [event for event in run.events if event.what.startswith("signal")]
    assert (lost.what, back.what) == ("signal lost", "signal back")
    assert reason in str(lost.detail["reason"])
    assert back.detail["after_s"] == pytest.approx(2.0, abs=0.5)
    assert run.summary["recovered"]["lost_signals"] == 1  # type: ignore[index]
    away = [cycle.shot for cycle in run.cycles if lost.time < cycle.shot.start < 5.4]
    assert {shot.mode for shot in away} == {mode}
    assert not any(isinstance(window, Actuate) for shot in away for window in shot.windows)


@pytest.mark.parametrize(
    ("fault", "status", "words"),
    [("windows_lost@3.5s", "failed", "Stale data: over "), ("excitation_lost@3.5s", "lost", "the signal was lost: ")],
)
def test_a_signal_that_stays_away_is_given_up_with_its_reason(fault: str, status: str, words: str) -> None:
    run = fly_with(fault, **{"stop.lost_s": "4.0"})
    assert (run.status, run.stop_reason[: len(words)]) == (status, words)
    assert "; the last one: " in run.stop_reason or "recording was lost" in run.stop_reason
    assert 7.0 < run.duration < 9.0


def test_a_speed_that_was_not_reached_is_told() -> None:
    summary = fly(load_steering_mission("line", settings={**SHORT, "path.speed_mm_s": "20"}), 3).summary
    assert summary["speed_reached"] is False
    speed: dict[str, float] = summary["path_speed_mm_s"]  # type: ignore[assignment]
    assert 0 < speed["mean"] < speed["wanted"] == pytest.approx(20.0)

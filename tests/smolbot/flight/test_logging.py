"""What a program can listen to: the logger ``smolbot``, silent until somebody listens."""

from __future__ import annotations

import logging

import numpy as np
import pytest

import smolbot
from smolbot.core.sensing import Recording
from smolbot.flight.safety.supervisor import make_limits_only_safety


def test_events_of_a_flight_and_its_end_are_logged_once_each(caplog):
    with caplog.at_level(logging.INFO, "smolbot"):
        run = smolbot.run("line", seed=1, stop__max_duration_s=2.0, localization__quiet_s=1.0, force="preview")
    messages = [record.getMessage() for record in caplog.records if record.name.startswith("smolbot.")]
    events = [text for text in messages if any(event.what in text for event in run.events)]
    assert len(events) == len(run.events) > 0
    assert messages[-1].endswith(f"timeout: {run.stop_reason}")
    assert caplog.records[-1].levelno == logging.WARNING


def test_a_lost_window_is_a_warning(caplog):
    safety = make_limits_only_safety(smolbot.Limits(("+x",), 8.0), 3)
    shot = smolbot.Shot((smolbot.Listen(2, 100.0),))
    with caplog.at_level(logging.WARNING, "smolbot"):
        assert safety.check_recording(shot, None, 1.0) is None
        safety.check_recording(shot, Recording(np.ones((3, 9)), 1e4, 0.0, np.zeros(3, bool), None, 0.99), 1.0)
    assert [record.levelname for record in caplog.records] == ["WARNING"]


def test_without_a_handler_nothing_is_printed(capsys):
    logging.getLogger("smolbot.flight.loop").warning("of no concern")
    assert capsys.readouterr() == ("", "")


def test_what_ended_a_run_is_in_it_with_its_fields():
    run = smolbot.run("line", seed=1, rig__safety__max_duty=1e-6, localization__quiet_s=0.0, force="preview")
    assert run.status == "failed"
    assert run.error.limit == 1e-6
    assert run.error.value > run.error.limit
    assert run.error.channel in run.stop_reason


def test_a_runs_cycles_are_columns():
    run = smolbot.run("line", seed=1, stop__max_duration_s=1.0, localization__quiet_s=0.0, force="preview")
    table = run.table()
    assert table["time"] == pytest.approx([cycle.shot.start for cycle in run.cycles])
    assert len(repr(run)) < 2000

"""Output of the commands for observations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import typer

from smolbot.core.results import as_json
from smolbot.ui.cli.show import echo_json, print_table

if TYPE_CHECKING:
    from smolbot.config.load import AnyMission
    from smolbot.flight.preview.gradient import Preview
    from smolbot.flight.preview.helix import HelixPreview
    from smolbot.flight.preview.observation import ObservationPreview


def make_observation_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Build the rows that an observation adds to the table of a run.

    Parameters
    ----------
    summary : dict
        Summary of the run.

    Returns
    -------
    list of (str, str)
        Empty for a mission that steers.
    """
    rows: list[tuple[str, str]] = []
    if "pose_rate_hz" in summary:
        gaps = summary["gaps"]
        text = (
            f"{gaps['count']}, {gaps['shots']} shots in all, longest {gaps['longest_s']:.2f} s"
            if gaps["count"]
            else "none"
        )
        rows += [("trusted poses", f"{summary['pose_rate_hz']:.2f} Hz"), ("gaps", text)]
    if "sigma_mm" in summary:
        place, turn = summary["sigma_mm"], summary["sigma_deg"]
        rows += [
            ("measurements", f"{summary['measurements']}, {summary['shots_per_measurement']:.1f} shots each"),
            ("mean position", "({:.2f}, {:.2f}, {:.2f}) mm".format(*summary["mean_mm"])),
            (
                "sigma",
                f"x {place['x']:.3f}, y {place['y']:.3f}, z {place['z']:.3f}, in space {place['distance']:.3f} mm",
            ),
            (
                "sigma of orientation",
                f"x {turn['x']:.2f}, y {turn['y']:.2f}, z {turn['z']:.2f}, angle {turn['angle']:.2f}°",
            ),
        ]
    elif "measurements" in summary:
        rows.append(("measurements", str(summary["measurements"])))
    return rows


def show_observation_preview(mission: AnyMission, found: ObservationPreview, json: bool) -> None:
    """Print the table or the JSON of a preview, and exit with 0 for go, 1 for no-go.

    Parameters
    ----------
    mission : Observation
    found : ObservationPreview
    json : bool
    """
    error = 1e3 * found.noise_error
    rows = [
        ("a cycle", found.shot.timeline(mission.rig.coil_names)),
        ("loop rate", f"{found.rate:.2f} Hz (timeline allows {found.rate_limit:.2f} Hz)"),
        ("expected duration", f"{found.duration:.0f} s, about {found.cycles} cycles"),
        (
            "noise alone",
            f"{error.min():.3f} to {error.max():.3f} mm rms in space, each pose; sensors out of place add to it",
        ),
    ]
    more = {
        **make_cycle_figures(found),
        "expected_duration_s": as_json(found.duration),
        "expected_cycles": found.cycles,
        "noise_error_mm": {"min": error.min(), "max": error.max()},
    }
    show_verdict(mission, found, rows, more if json else None)


def make_cycle_figures(found: Preview | ObservationPreview) -> dict[str, Any]:
    """Build the JSON output about a cycle.

    Parameters
    ----------
    found : Preview or ObservationPreview

    Returns
    -------
    dict
    """
    return {
        "cycle": str(found.shot),
        "cycle_ms": found.shot.duration * 1e3,
        "timeline_limit_hz": found.rate_limit,
        "loop_rate_hz": found.rate,
    }


def show_verdict(
    mission: AnyMission,
    found: Preview | HelixPreview | ObservationPreview,
    rows: list[tuple[str, str]],
    figures: dict[str, Any] | None,
) -> None:
    """Print the table of a preview, and its JSON if there are `figures`; exit with 0 for go, 1 for no-go.

    Parameters
    ----------
    mission : Mission or Observation
    found : Preview, HelixPreview or ObservationPreview
    rows : list of (str, str)
    figures : dict or None
        None for no JSON.

    Raises
    ------
    typer.Exit
        Always.
    """
    rows = [*rows, ("verdict", "go" if found.go else "no-go: " + " ".join(found.reasons))]
    print_table(f"preview of {mission.name} on {mission.rig.name}", rows, err=figures is not None)
    if figures is not None:
        head = {"mission": mission.name, "rig": mission.rig.name, "go": found.go, "reasons": found.reasons}
        echo_json(head | figures)
    raise typer.Exit(0 if found.go else 1)

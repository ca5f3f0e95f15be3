"""The sections of a report on events and provenance."""

from __future__ import annotations

from smolbot.runs.report.page_elements import ELEMENTS, Section
from smolbot.runs.report.recorded_flight import RecordedFlight
from smolbot.runs.report.setting_differences import flatten

_LONG = 160  # characters of an event's detail that are shown


LABELS = {
    "array learned": "sensor positions estimated",
    "coil tails learned": "coil current decay identified",
    "ring-down learned": "excitation ring-down identified",
    "noise learned": "noise model identified",
}
"""Names of events in a report, if those in the record are not clear enough."""


def build_events_section(flight: RecordedFlight) -> Section:
    """Build the section on events; a series of equal events is shortened.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    Section
    """
    section = Section("events", "Events")
    events = flight.record.events
    recovered = {kind: times for kind, times in flight.run.recovered.items() if times}
    if recovered:
        counts = ", ".join(f"{kind.replace('_', ' ')} {times}" for kind, times in recovered.items())
        section.add_paragraph(f"Recovered from during the run: {counts}.")
    if not events:
        return section.add_missing_note("Nothing was recorded.")
    rows: list[list[str]] = []
    last, count = "", 0
    for event in events:
        count = count + 1 if event.what == last else 1
        which = f" (number {count} in a row)" if count > 1 else ""
        row = [f"{event.time:.2f} s", LABELS.get(event.what, event.what) + which, _format_detail(event.detail)]
        if count > 2:
            rows[-1] = row
        else:
            rows.append(row)
        last = event.what
    return section.add(ELEMENTS.table(rows, ("time", "what", "detail"), wide=True))


def build_provenance_section(flight: RecordedFlight) -> Section:
    """Build the section on version, commit, seed, settings, sampled mismatches, packages, and the files themselves.

    Parameters
    ----------
    flight : RecordedFlight

    Returns
    -------
    Section
    """
    section = Section("provenance", "Provenance")
    found = dict(flight.record.provenance)
    world, packages = found.pop("world", {}), found.pop("packages", {})
    settings = found.pop("settings", {})
    rows = [(name, "not known" if value is None else value) for name, value in found.items()]
    rows += [(f"--set {name}", value) for name, value in settings.items()]
    rows.append(("record", f"{flight.record.path.name}, {flight.record.path.stat().st_size / 1e6:.1f} MB"))
    section.add(ELEMENTS.table(rows))
    if not settings:
        section.add_paragraph("No settings override the files.")
    sampled = ELEMENTS.table(flatten(world).items()) if world else "Nothing."
    section.add(
        ELEMENTS.folded("Sampled mismatches of the simulated world, hidden from controller and localizer", sampled)
    )
    section.add(ELEMENTS.folded("Packages", ELEMENTS.table(sorted(packages.items()))))
    for name, content in sorted(flight.record.begin.files.items()):
        if name.endswith(".toml"):
            section.add(ELEMENTS.folded(name, ELEMENTS.preformatted(content.decode(errors="replace"))))
    return section


def _format_detail(detail: dict[str, object]) -> str:
    values = {name.replace("_", " "): value for name, value in detail.items() if value not in ("", None)}
    text = ", ".join(f"{name}: {_format_short(value)}" for name, value in values.items())
    return text if len(text) <= _LONG else text[: _LONG - 1] + "…"


def _format_short(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list) and value and isinstance(value[0], list):
        return f"{len(value)} by {len(value[0])} values"
    if isinstance(value, list):
        return "[" + ", ".join(_format_short(v) for v in value[:8]) + (", …]" if len(value) > 8 else "]")
    return str(value)

"""Checks that only a person at the bench can do."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from smolbot.config.rig import RigConfig


def by_hand(rig: RigConfig) -> list[str]:
    """List what a person must verify on a rig.

    Parameters
    ----------
    rig : RigConfig

    Returns
    -------
    list of str
        A sentence each, in a sensible order.
    """
    sections = rig.sections
    wires = rig.raw_section("bench")
    if wires and not wires.get("operator", {}).get("stop_line"):
        found = ["No emergency button is wired (bench.operator.stop_line): who stands at the mains switch?"]
    else:
        found = [
            "Emergency button: press it once during a quiet shot. The run ends, the amplifiers go dark, and it stays "
            "so until the button is pulled."
        ]
    if sections.coils:
        order = ", ".join(rig.coil_names)
        found.append(
            f"Coils {order}: with a hand compass over the sample place and a third of an ampere from the amplifier's "
            "test input, the needle's north end turns toward the coil that is driven."
        )
    bobbins = " and ".join(coil.name for coil in sections.excitation)
    found += [
        f"Excitation coils ({bobbins}): cooling water runs, hoses are dry, and the bobbins are cold to the touch.",
        "Sensors: none is loose on its plate. Bring a screwdriver to each in turn: the one of that number moves.",
        "Room: no steel tool, phone, chair or door within a metre of the sensors moves while a run lasts.",
    ]
    if sections.magnet is not None:
        found += [
            f"Magnet ({sections.magnet.side_mm:g} mm cube, strong): no card, pacemaker or finger on its way; it moves "
            "freely by hand from away to near and back, and each end switch clicks.",
            "Steering axis: stands at its mark while the stage is switched on; it is counted from there.",
            "Magnet motors: with the stage disarmed the shaft turns by hand; with the mains switch off it coasts.",
        ]
    surface = sections.container.surface_z_mm - sections.container.floor_z_mm
    found += [
        f"Container: level, filled {surface:g} mm deep with {sections.medium.name}, at its place in the frame.",
        "Robot: free of bubbles, does not touch a wall, swings when it is tapped.",
    ]
    return found

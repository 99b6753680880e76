"""Every profile of a drive as a page: the names, units, sides and timing of its channels."""

from __future__ import annotations

from jointid.records.drives import load_profile, profile_names

HEAD = """# Profiles of drives

Written from the profiles that the program reads. In names, `{axis}` is `drive.axis`, `{index}` one less, and `{joint}`
is `drive.joint`; [drives and their traces](../../drives.md#the-profiles) says more.
"""


def page() -> str:
    """Return the page, with a section for each profile."""
    return "\n".join([HEAD, *map(_section, profile_names())])


def _section(name: str) -> str:
    profile = load_profile(name)
    parts = [f"## `{name}`: {profile.title}\n"]
    parts.append("| channel | names | unit | side | timing | tap |\n|---|---|---|---|---|---|")
    for channel, signals in profile.channels.items():
        for one in signals:
            called = ", ".join(f"`{word}`" for word in one.names)
            cells = (channel, called, *(str(cell or "") for cell in (one.unit, one.side, one.timing, one.tap)))
            parts.append(f"| {' | '.join(cells)} |")
    for said, number in (("Rated torque", profile.rated_torque), ("Counts", profile.counts)):
        parts += [f"\n{said}: {number}."] if number else []
    for said, lines in (("Sources", profile.sources), ("Assumed, to be compared with the drive", profile.assumed)):
        parts.append("\n".join([f"\n{said}:\n", *(f"- {line}" for line in lines)]))
    return "\n".join([*parts, ""])

"""Recognise whose log a file is: the profile whose names most of its columns have, and its axes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from jointid.common.text import join, pluralise
from jointid.records.drives import Place, Profile, Spoken, index_columns, load_profile, place_of, profile_names
from jointid.records.record import CHANNELS

_LAST = "generic"  # whose names others have too
_PLAIN = re.compile(r"(?:.*[./])?(?:q|tau)_?\d*\s*(?:[\[(].*)?", re.IGNORECASE)  # names of any log
_MOST = 64  # axes of a log


@dataclass(frozen=True, slots=True)
class LoggedAxis:
    """An axis of a log.

    Attributes:
        place: its number or its name, as the profile's names have it; empty of a log of one axis.
        channels: column of each channel.
    """

    in_json = "name -place"
    place: Place
    channels: Mapping[str, str]

    @property
    def name(self) -> str:
        """Name of the joint, or one made of its number."""
        return str(self.place.get("joint", f"joint{self.place.get('axis', 1)}"))


@dataclass(frozen=True, slots=True)
class Recognised:
    """Whose log a file is.

    Attributes:
        profile: of the drive.
        axes: in the order of their numbers, or of the file.
    """

    in_json = "sentence -profile"
    profile: Profile
    axes: tuple[LoggedAxis, ...]

    @property
    def sentence(self) -> str:
        """The recognised log in a sentence."""
        channels = join([name for name in CHANNELS if any(name in axis.channels for axis in self.axes)])
        return (
            f'The columns are those of profile "{self.profile.name}" ({self.profile.title}): '
            f"{pluralise(len(self.axes), 'axis', 'axes')} with {channels}."
        )


def recognise(columns: tuple[str, ...]) -> Recognised | None:
    """Recognise whose log has these columns; None where no profile knows a position, and another channel or axis.

    "q" and "tau" alone are nobody's names. Of several profiles the one counts that knows most columns; the plain names
    come last.
    """
    spoken, best, most = index_columns(columns), None, 1
    for name in sorted(profile_names(), key=lambda one: (one == _LAST, one)):
        if name != _LAST or best is None:
            profile = load_profile(name)
            axes = tuple(_find_axes(profile, columns, spoken))
            names = [column for axis in axes for column in axis.channels.values()]
            if len(names) > most and not all(map(_PLAIN.fullmatch, names)):
                best, most = Recognised(profile, axes), len(names)
    return best


def _find_axes(profile: Profile, columns: tuple[str, ...], spoken: Spoken) -> Iterator[LoggedAxis]:
    """Yield axes with a position of their own, each column at its first place."""
    known = [name for signals in profile.channels.values() for one in signals for name in one.names]
    every = (re.escape(name).replace(r"\{joint\}", r"([^/]+)") for name in known if "{joint}" in name)
    patterns = [re.compile(f"(?:.*[./])?{one}", re.IGNORECASE) for one in every]
    found = (next(filter(None, (one.fullmatch(name) for one in patterns)), None) for name in columns)
    joints = dict.fromkeys(match[1] for match in found if match)
    taken = set[str]()
    for place in (place_of(), *map(place_of, range(1, _MOST + 1)), *(place_of(joint=name) for name in joints)):
        free = {channel: set(profile.find(channel, spoken, place)) - taken for channel in profile.channels}
        channels = {channel: names.pop() for channel, names in free.items() if len(names) == 1}
        if "motor_position" in channels or "reference" in channels:
            taken.update(channels.values())
            yield LoggedAxis(place, channels)

"""Describe whose sonar and sea floor a model is fitted for: what carries it, over what, and what else is configured."""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from auv_mcm.model_file import NONE, SHIPPED
from auv_mcm.safe_files import read_regular
from auv_mcm.settings.config import USUAL_BEAM_DEG, Config, SonarConfig
from sim_replay.augment.augment_log import TRUTH_NAME
from sim_replay.fitting.cascade.spec import SonarVariant, carrying, on_grid, read_training_spec, within_swath
from sim_replay.fitting.cascade.tiles import Split
from sim_replay.missions import HELD_OUT, SCENES, config_for
from sim_replay.simulator.plan import place_in_plane, planned_legs, swath_m
from sim_replay.simulator.scene import Scene

_PING_SHARE: Final = 0.95  # of the ping rate that the way of sound to the end of the range and back allows


class Theatre(NamedTuple):
    """Hold what missions are flown with.

    config: of the payload; what it says of picture, detection, confirmation and contacts counts, and of the sonar for
    lines. sonars: carried in
    turn, by the mission's number. scenes: names or files, none for the named ones. lines: folders of `auv-mcm augment`
    with the split that each is of. test_seeds: of missions to judge on. options: of the command line, that name all
    this.
    """

    config: Config = Config()
    sonars: tuple[SonarVariant, ...] = (SonarVariant(),)
    scenes: tuple[str, ...] = ()
    lines: tuple[tuple[Split, str], ...] = ()
    test_seeds: tuple[int, ...] = ()
    options: str = ""

    @property
    def flown(self) -> tuple[str, ...]:
        """Name the scenes to fit the cascade's followers on: those that are held out from its training are not."""
        return self.scenes or tuple(name for name in SCENES if name not in HELD_OUT)

    @property
    def beam_width_deg(self) -> float:
        """Give the mean beam width of its sonars, or the usual one if that is wider."""
        usual = USUAL_BEAM_DEG
        widths = [usual if one.beam_width_deg is None else one.beam_width_deg for one in self.sonars]
        return max(usual, sum(widths) / len(widths))

    def lines_of(self, split: Split) -> list[str]:
        """List the folders of a split."""
        return [folder for each, folder in self.lines if each == split]

    def carried(self, scene: Scene, number: int) -> tuple[Scene, Config]:
        """Let a mission carry the sonar whose turn it is, no faster than sound allows, and configure the payload.

        What lies beyond the sonar's reach is left out.
        """
        sonar = self.sonars[number % len(self.sonars)]
        flown = carrying(scene, sonar)
        if sonar.range_m is not None:
            flown = _within_reach(within_swath(flown))
        if sonar.ping_rate_hz is None:
            fastest_hz = _PING_SHARE * 0.5 * flown.sonar.sound_speed_mps / flown.sonar.range_m
            rate_hz = min(flown.sonar.ping_rate_hz, fastest_hz) if sonar.range_m else flown.sonar.ping_rate_hz
            flown = msgspec.structs.replace(flown, sonar=msgspec.structs.replace(flown.sonar, ping_rate_hz=rate_hz))
        config = msgspec.structs.replace(self.config, sonar=SonarConfig())  # the scene's vehicle carries its own
        return flown, config_for(flown, on_grid(config, sonar))

    def digest(self) -> str:
        """Digest what the files hold that missions go by: scenes, augmented lines and the detector."""
        lines = (f"{folder}/{TRUTH_NAME}" for _, folder in self.lines)
        files = map(Path, (*self.scenes, self.config.detect.model, *lines))
        return sha256(b"".join(read_regular(file) for file in files if file.is_file())).hexdigest()

    def with_files(self, **files: str) -> Theatre:
        """Name fitted files in the configuration."""
        return self._replace(config=with_files(self.config, **files))

    def before_odds(self) -> Theatre:
        """Take out what the odds decide, to fit them; the gate of other odds goes if the detector is not the usual."""
        gate = SHIPPED if self.config.detect.model in (SHIPPED, NONE) else NONE
        return self.with_files(odds=SHIPPED, gate=gate, background=SHIPPED)


def _within_reach(scene: Scene) -> Scene:
    """Leave out the single objects that no leg of the scene's sonar reaches."""
    reach_m, legs = swath_m(scene), planned_legs(scene.track.plan)
    placed = [(one, place_in_plane(scene, one)) for one in scene.objects]
    seen = tuple(one for one, place_m in placed if min(leg.distance_m(*place_m) for leg in legs) <= reach_m)
    return msgspec.structs.replace(scene, objects=seen)


def with_files(config: Config, **files: str) -> Config:
    """Name fitted files in a configuration: model, gate, performance, seabed_model of `detect`, odds, background."""
    detect = {name: file for name, file in files.items() if name not in ("odds", "background")}
    odds, background = files.get("odds", config.confirm.odds), files.get("background", config.contacts.background)
    return msgspec.structs.replace(
        config,
        detect=msgspec.structs.replace(config.detect, **detect),
        confirm=msgspec.structs.replace(config.confirm, odds=odds),
        contacts=msgspec.structs.replace(config.contacts, background=background),
    )


USUAL: Final = Theatre()
"""What ships was fitted for."""


def read_theatre(spec: Path | None, config: Config, options: str) -> Theatre:
    """Read scenes, sonars and augmented lines of a training set, and take from a configuration what fits count.

    Raises UsageError for a set that cannot be read, as `read_training_spec` does.
    """
    confirm = msgspec.structs.replace(config.confirm, targets=SHIPPED)
    sections = {name: getattr(config, name) for name in ("sonar", "detect", "contacts", "waterfall")}
    own = Config(confirm=confirm, **sections)
    if spec is None:
        return Theatre(config=own, options=options)
    known, base = read_training_spec(spec)
    beside = [str(base / name) if (base / name).is_file() else name for name in known.scenes]
    test = known.seeds.test if known.seeds is not None else None
    return Theatre(
        config=own,
        sonars=known.sonars,
        scenes=tuple(beside),
        lines=tuple((log.split, str(base / log.folder)) for log in known.augmented),
        test_seeds=() if test is None else tuple(test.seeds),
        options=options,
    )

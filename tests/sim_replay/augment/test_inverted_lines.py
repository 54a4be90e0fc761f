"""Lines of recorded missions, from pings to the relief in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from auv_mcm.errors import BadInputError
from auv_mcm.settings.config import Config
from sim_replay.augment.forward import render_image
from sim_replay.logs.recorded import RecordedMission
from sim_replay.studies.recorded_lines import invert_waterfall, waterfall_pictures
from tests.sim_replay.logs.xtf_logs import written


def test_log_gives_pictures_and_scenes_of_both_sides(tmp_path: Path) -> None:
    log, config = written(tmp_path / "log.xtf", 150), Config()
    for side in ("port", "starboard"):
        found = list(invert_waterfall(RecordedMission([log], config).events(), config, side))
        assert found
        for picture, scene in found:
            assert picture.side == side
            assert picture.valid[:, -1].any()
            assert not picture.intensity[~picture.valid].any()
            assert (np.diff(picture.along_m) > 0.0).all()
            assert (
                scene.elevation_m.shape == picture.intensity.shape == (len(picture.altitude_m), picture.valid.shape[1])
            )
            image, rendered = (
                picture.intensity[picture.valid].mean(),
                render_image(scene).intensity[picture.valid].mean(),
            )
            assert 0.7 < rendered / image < 1.4


def test_rows_follow_one_another_without_gap_or_overlap(tmp_path: Path) -> None:
    config = Config()
    pictures = list(
        waterfall_pictures(RecordedMission([written(tmp_path / "log.xtf", 400)], config).events(), config, "port")
    )
    along_m = np.concatenate([picture.along_m for picture in pictures])
    np.testing.assert_allclose(np.diff(along_m), config.waterfall.row_spacing_m, rtol=1e-9)


def test_missing_log_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match="does not exist"):
        list(waterfall_pictures(RecordedMission([tmp_path / "none.xtf"], Config()).events(), Config(), "port"))

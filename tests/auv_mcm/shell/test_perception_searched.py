"""What was searched outlasts a restart, and checkpoints do not grow with it."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import msgspec
import numpy as np
import pytest

from auv_mcm.clearance.clearance_map import Clearance
from auv_mcm.plan.clear_area import ClearArea
from auv_mcm.plan.look_again import PlanRequest
from auv_mcm.records import CoveragePatch, Ping, PipelineEvent, SourceEvent
from auv_mcm.settings.config import Config
from auv_mcm.shell.checkpoint import Keeping, commit_checkpoint
from auv_mcm.shell.perception_chain import PerceptionChain
from tests.auv_mcm.contacts.temporary_records import temporary_record_file
from tests.auv_mcm.plan.test_propose import geodetic
from tests.auv_mcm.shell import fake_pipelines as fake
from tests.auv_mcm.shell.test_perception_area import CONFIG
from tests.make.records import cells_of, patch_of


class Searching(fake.Base):
    """Sees 3 x 500 cells per ping, each time further north."""

    def feed(self, event: SourceEvent) -> list[PipelineEvent]:
        assert isinstance(event, Ping)
        places = {(east, 2 * event.number + north): 0.5 for east in range(500) for north in range(3)}
        cells = cells_of(places, ground_range_m=20.0, altitude_m=5.0, look_rad=np.linspace(0.0, 6.0, 1500))
        return [patch_of(start_s=event.time_s, stop_s=event.time_s + 1.0, cells=cells)]


def searched(chain: PerceptionChain) -> Clearance:
    clearance = chain.last_answer().clearance
    assert clearance is not None
    return clearance


@pytest.mark.parametrize("config", [Config(), CONFIG], ids=["anywhere", "an area"])
def test_a_checkpoint_is_as_large_after_forty_patches_as_after_ten(
    tmp_path: Path, config: Config, monkeypatch: pytest.MonkeyPatch
) -> None:
    keeping, n_bytes = Keeping(tmp_path, "kind"), []
    shown: list[CoveragePatch] = []
    monkeypatch.setattr(ClearArea, "add", lambda area, patch: shown.append(patch))
    with closing(temporary_record_file(tmp_path)) as records:
        chain = PerceptionChain(config, Searching, records, keeping)
        for number in range(1, 41):
            chain.keep(chain.feed(fake.ping(number)).patches)
            if number % 10 == 0:
                chain.propose(PlanRequest(*geodetic(-20.0, -20.0), 0.0, frozenset()))
                assert chain.checkpoint(number)()
                commit_checkpoint(tmp_path, number)
                n_bytes.append((tmp_path / f"checkpoint-{number:012d}.bin").stat().st_size)
        assert len(shown) == (40 if config.plan.area_deg else 0), "planning learns of each"
        assert n_bytes[-1] - n_bytes[0] < 40 * 150, "places in the file, of cells of 45 bytes"
        restarted = searched(PerceptionChain(config, Searching, records, keeping))
        for name, before in msgspec.structs.asdict(searched(chain)).items():
            np.testing.assert_array_equal(getattr(restarted, name), before)

"""A survey leg that was flown is not requested again, whatever becomes of the process that plans."""

from __future__ import annotations

import asyncio
from contextlib import closing
from pathlib import Path

from auv_mcm.plan.look_again import PlanRequest, Run
from auv_mcm.settings.config import Config
from auv_mcm.settings.plan_settings import PlanConfig
from auv_mcm.shell.checkpoint import Keeping, commit_checkpoint
from auv_mcm.shell.perception import Perception
from auv_mcm.shell.perception_messages import Checkpointed, Planned
from tests.auv_mcm.contacts.temporary_records import temporary_record_file
from tests.auv_mcm.plan.test_clear_area import runs
from tests.auv_mcm.plan.test_propose import SQUARE, fenced, geodetic
from tests.auv_mcm.shell import fake_pipelines as fake

AREA = tuple(geodetic(*corner) for corner in ((0.0, 0.0), (0.0, 60.0), (80.0, 60.0), (80.0, 0.0)))
CONFIG = Config(plan=PlanConfig(area_deg=AREA), vehicle=fenced(SQUARE))


async def planned(perception: Perception, keeping: Keeping, flown: tuple[Run, ...]) -> list[Run]:
    request = PlanRequest(*geodetic(-20.0, -20.0), 0.0, frozenset(), flown=flown, time_s=fake.START_S + 1.0)
    assert perception.ask(request)
    while not isinstance(answer := await perception.answer(), Planned):
        if isinstance(answer, Checkpointed):
            commit_checkpoint(keeping.folder, answer.number)
    return runs(answer.proposal.waypoints)


def test_a_restart_right_after_a_survey_leg_does_not_request_it_again(tmp_path: Path) -> None:
    async def legs() -> tuple[list[Run], list[Run], list[Run]]:
        keeping = Keeping(tmp_path, "kind")
        sonar = fake.ping(1, port=fake.trace(1, 300), starboard=fake.trace(2, 300))
        with closing(temporary_record_file(tmp_path)) as records:
            with closing(Perception(CONFIG, fake.Base, records=records, keeping=keeping)) as perception:
                await perception.start()
                await perception.feed(sonar, number=1)
                before = await planned(perception, keeping, ())
                after = await planned(perception, keeping, (before[0],))
            with closing(Perception(CONFIG, fake.Base, records=records, keeping=keeping)) as perception:
                started = await perception.start()
                if started.number < 1:
                    await perception.feed(sonar, number=1)
                return before, after, await planned(perception, keeping, ())

    before, after, restarted = asyncio.run(legs())
    assert before[0] not in after
    assert before[0] not in restarted
    assert restarted

"""The health line, the table and Prometheus' text say what the record holds."""

from __future__ import annotations

import re

from auv_mcm.shell.health.record import REASONS, VALUES, Health, Part, parse_health
from auv_mcm.shell.health.text import health_line, health_table, metric_name, prometheus_text
from auv_mcm.source import SourceHealth
from tests.auv_mcm.shell.health.measurements import LATER, PORT, POSITION, WELL, record

SAMPLE = re.compile(r'([a-z_:][a-z0-9_:]*)(\{(?:[a-z]+="(?:[^"\\]|\\.)*",?)*\})? (\S+)')
"""A sample of the text format, https://prometheus.io/docs/instrumenting/exposition_formats/."""

ILL = LATER._replace(
    has_kernels=False, source=SourceHealth((PORT._replace(state="down"), PORT._replace(name="gps")), (POSITION,))
)


def test_the_line_has_counts_ports_vehicle_and_state() -> None:
    assert health_line(record()) == (
        "pings=150 queue=2/512 in_flight=40 dropped=0 contacts=4 clutter=7 lag_ms=1.0 ports=sonar:up "
        "vehicle=granted (by IMC) state=normal"
    )
    ill = health_line(record(ILL))
    assert "kernels=NUMPY ports=sonar:down,gps:up " in ill
    assert ill.endswith("state=fault,perception:no_kernels,port.sonar:port_down")


def test_the_table_names_each_part_and_explains_each_reason_once() -> None:
    table = health_table(record(ILL), 2.0).splitlines()
    assert table[0] == "auv-mcm 1.2.3  fault  2 s ago  results/session-1"
    assert [line for line in table if line.startswith("FAULT     port.sonar ")]
    assert [line for line in table if line.startswith("degraded  perception ")]
    for reason in ("port_down", "no_kernels"):
        assert table.count(f"{reason}: {REASONS[reason]}") == 1


def test_every_line_for_prometheus_has_its_form_and_each_value_its_meaning() -> None:
    text = prometheus_text(record(ILL))
    names = set()
    for line in text.splitlines():
        if not line.startswith("# "):
            sample = SAMPLE.fullmatch(line)
            assert sample is not None, line
            float(sample[3])
            names.add(sample[1])
    assert {f"auv_mcm_{metric_name(name)}" for name in VALUES} <= names
    for name in names:
        assert text.count(f"# TYPE {name} ") == text.count(f"# HELP {name} ") == 1
    assert 'auv_mcm_state{part="port.sonar"} 3' in text
    assert 'auv_mcm_reason{part="perception",code="no_kernels"} 1' in text
    assert "# TYPE auv_mcm_pings_total counter" in text
    assert 'auv_mcm_received_bytes_per_second{part="port.sonar"} ' in text


def test_a_name_of_a_port_cannot_forge_a_line() -> None:
    part = Part(name='port.a"} 1\nauv_mcm_x 2\\', state="normal", values={"age_s": 1.0}, words="\x1b[2J")
    health = Health(version="1", session="s", utc_s=0.0, period_s=1.0, parts=(part,))
    lines = prometheus_text(health).splitlines()
    assert [line for line in lines if not line.startswith("# ") and SAMPLE.fullmatch(line) is None] == []
    assert not [line for line in lines if line.startswith("auv_mcm_x")]
    assert "\x1b" not in health_table(health, 0.0)
    assert b"\x1b" not in health.to_json()


def test_json_gives_the_same_record_back() -> None:
    for health in (record(), record(ILL), record(WELL, WELL)):
        assert parse_health(health.to_json()) == health
    assert b'"state":"fault"' in record(ILL).to_json()[:40]
